#version 450
// Colour in the scene's lights, by Lambert's law in the picture's own numbers (sRGB), and the exact surface at each
// pixel's centre: position in the camera's frame, the normal in the world's axes, and the entity's number. Binding
// places are those that SAPIEN's renderer fills.

layout (constant_id = 0) const int NUM_DIRECTIONAL_LIGHTS = 0;
layout (constant_id = 1) const int NUM_DIRECTIONAL_LIGHT_SHADOWS = 0;
layout (constant_id = 2) const int NUM_POINT_LIGHTS = 0;
layout (constant_id = 3) const int NUM_POINT_LIGHT_SHADOWS = 0;
layout (constant_id = 4) const int NUM_SPOT_LIGHTS = 0;
layout (constant_id = 5) const int NUM_SPOT_LIGHT_SHADOWS = 0;
layout (constant_id = 6) const int NUM_TEXTURED_LIGHT_SHADOWS = 0;

layout(set = 0, binding = 0) uniform CameraBuffer {
  mat4 viewMatrix;
  mat4 projectionMatrix;
  mat4 viewMatrixInverse;
  mat4 projectionMatrixInverse;
  float width;
  float height;
} cameraBuffer;

layout(set = 1, binding = 0) uniform ObjectTransformBuffer {
  mat4 modelMatrix;
} objectTransformBuffer;

layout(set = 1, binding = 1) uniform ObjectDataBuffer {
  uvec4 segmentation;
  float transparency;
  int shadeFlat;
} objectDataBuffer;

layout(set = 2, binding = 0) uniform MaterialBuffer {
  vec4 emission;
  vec4 baseColor;
  float fresnel;
  float roughness;
  float metallic;
  float transmission;
  float ior;
  float transmissionRoughness;
  int textureMask;
  int padding1;
  vec4 textureTransforms[6];
} materialBuffer;

layout(set = 2, binding = 1) uniform sampler2D colorTexture;
layout(set = 2, binding = 2) uniform sampler2D roughnessTexture;
layout(set = 2, binding = 3) uniform sampler2D normalTexture;
layout(set = 2, binding = 4) uniform sampler2D metallicTexture;
layout(set = 2, binding = 5) uniform sampler2D emissionTexture;
layout(set = 2, binding = 6) uniform sampler2D transmissionTexture;

struct PointLight { vec4 position; vec4 emission; };
struct DirectionalLight { vec4 direction; vec4 emission; };
struct SpotLight { vec4 position; vec4 direction; vec4 emission; };

layout(set = 3, binding = 0) uniform SceneBuffer {
  vec4 ambientLight;
  PointLight pointLights[10];
  DirectionalLight directionalLights[3];
  SpotLight spotLights[10];
  SpotLight texturedLights[1];
} sceneBuffer;

struct LightBuffer {
  mat4 viewMatrix;
  mat4 viewMatrixInverse;
  mat4 projectionMatrix;
  mat4 projectionMatrixInverse;
  int width;
  int height;
};

layout(set = 3, binding = 1) uniform ShadowBuffer {
  LightBuffer pointLightBuffers[60];
  LightBuffer directionalLightBuffers[3];
  LightBuffer spotLightBuffers[10];
  LightBuffer texturedLightBuffers[1];
} shadowBuffer;

layout(set = 3, binding = 2) uniform samplerCube samplerPointLightDepths[10];
layout(set = 3, binding = 3) uniform sampler2D samplerDirectionalLightDepths[3];
layout(set = 3, binding = 4) uniform sampler2D samplerSpotLightDepths[10];
layout(set = 3, binding = 5) uniform sampler2D samplerTexturedLightDepths[1];
layout(set = 3, binding = 6) uniform sampler2D samplerTexturedLightTextures[1];
layout(set = 3, binding = 7) uniform samplerCube samplerEnvironment;

layout(location = 0) in vec4 inPosition;
layout(location = 1) in vec2 inUV;
layout(location = 2) in flat uvec4 inSegmentation;
layout(location = 3) in vec3 objectCoord;
layout(location = 4) in mat3 inTbn;

layout(location = 0) out vec4 outColorRaw;
layout(location = 1) out vec4 outPosition;
layout(location = 2) out vec4 outNormal;
layout(location = 3) out uvec4 outSegmentation;
layout(location = 4) out vec4 outAlbedo;

// The share of a 2x2 neighbourhood in the shadow map that the light reaches.
float lit(int light, vec3 position) {
  mat4 toMap = shadowBuffer.directionalLightBuffers[light].projectionMatrix
             * shadowBuffer.directionalLightBuffers[light].viewMatrix;
  vec4 projected = toMap * cameraBuffer.viewMatrixInverse * vec4(position, 1);
  vec3 place = projected.xyz / projected.w;
  vec2 uv = 0.5 * place.xy + 0.5;
  if (any(lessThan(uv, vec2(0))) || any(greaterThan(uv, vec2(1)))) return 1.0;
  vec4 nearest = textureGather(samplerDirectionalLightDepths[light], uv);
  return dot(vec4(greaterThanEqual(nearest, vec4(place.z - 4e-4))), vec4(0.25));
}

void main() {
  vec4 albedo = materialBuffer.baseColor;
  // Albedo is the shape's colour; a texture multiplies it in colour images only.
  vec3 plain = pow(clamp(albedo.rgb, 0.0, 1.0), vec3(1 / 2.2));
  if ((materialBuffer.textureMask & 1) != 0) {
    vec4 laid = texture(colorTexture, inUV);
    albedo = vec4(albedo.rgb * laid.rgb, laid.a);
  }
  albedo.a *= 1.0 - objectDataBuffer.transparency;
  if (albedo.a == 0) discard;

  vec3 normal = normalize(inTbn[2]);
  vec3 worldNormal = mat3(cameraBuffer.viewMatrixInverse) * normal;
  vec3 light = sceneBuffer.ambientLight.rgb;
  for (int i = 0; i < NUM_DIRECTIONAL_LIGHTS; ++i) {
    vec3 direction = mat3(cameraBuffer.viewMatrix) * sceneBuffer.directionalLights[i].direction.xyz;
    float facing = max(dot(normal, -direction), 0.0);
    float reached = i < NUM_DIRECTIONAL_LIGHT_SHADOWS ? lit(i, inPosition.xyz) : 1.0;
    light += reached * facing * sceneBuffer.directionalLights[i].emission.rgb;
  }
  vec3 own = pow(clamp(albedo.rgb, 0.0, 1.0), vec3(1 / 2.2));
  outColorRaw = vec4(clamp(own * light, 0.0, 1.0), albedo.a);
  // The fourth part is opacity: SAPIEN blends what is not whole numbers.
  outPosition = vec4(inPosition.xyz, 1);
  outNormal = vec4(worldNormal, 1);
  outSegmentation = inSegmentation;
  outAlbedo = vec4(plain, 1);
}
