#version 450
// Lays what was drawn over the scene's sky, whose colours take the place of SKY_ABOVE and SKY_BELOW.

layout(set = 0, binding = 0) uniform sampler2D samplerColorRaw;
layout(set = 0, binding = 1) uniform sampler2D samplerGbufferDepth;

layout(set = 1, binding = 0) uniform CameraBuffer {
  mat4 viewMatrix;
  mat4 projectionMatrix;
  mat4 viewMatrixInverse;
  mat4 projectionMatrixInverse;
  float width;
  float height;
} cameraBuffer;

layout(location = 0) in vec2 inUV;
layout(location = 0) out vec4 outColor;

void main() {
  vec4 color = texture(samplerColorRaw, inUV);
  vec4 far = cameraBuffer.projectionMatrixInverse * vec4(inUV * 2 - 1, 0.5, 1);
  vec3 ray = normalize(mat3(cameraBuffer.viewMatrixInverse) * (far.xyz / far.w));
  vec3 sky = mix(SKY_BELOW, SKY_ABOVE, 0.5 + 0.5 * ray.z);
  outColor = vec4(mix(sky, color.rgb, color.a), 1.0);
}
