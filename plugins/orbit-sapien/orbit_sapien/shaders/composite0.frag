#version 450
// Lays what was drawn over a sky that is paler at the horizon.

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
  vec3 sky = mix(vec3(0.80, 0.85, 0.90), vec3(0.42, 0.58, 0.78), sqrt(clamp(ray.z, 0.0, 1.0)));
  outColor = vec4(mix(sky, color.rgb, color.a), 1.0);
}
