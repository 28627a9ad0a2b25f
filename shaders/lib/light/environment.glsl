// Light from infinitely far. Layouts: core/light/environment.py (ps_environment), light_table.py (ps_lights).
// PS_HAS_WORLD: a colour. PS_HAS_ENVIRONMENT: an image instead.

#include "lib/light/brdf.glsl"

#define PS_WORLD_ROW PS_TABLE_ROWS
#define PS_TILE_WIDTH 128
#define PS_TILE_HEIGHT 64
#define PS_ROUGH_LEVELS 5
#define PS_ROUGH_STEP 0.2
#define PS_GATHERED_LEVEL (PS_ROUGH_LEVELS + 2)

#ifdef PS_HAS_ENVIRONMENT

vec3 ps_image_from_view(vec3 direction)
{
  return texelFetch(ps_lights, ivec2(1, PS_WORLD_ROW), 0).xyz * direction.x +
         texelFetch(ps_lights, ivec2(2, PS_WORLD_ROW), 0).xyz * direction.y +
         texelFetch(ps_lights, ivec2(3, PS_WORLD_ROW), 0).xyz * direction.z;
}

// Bilinear sample of an equirectangular image of this size, whose corner lies at `origin` of a texture.
vec3 ps_equirectangular(sampler2D picture, ivec2 origin, ivec2 size, vec2 uv)
{
  float x = uv.x * float(size.x) - 0.5;
  float y = clamp(uv.y * float(size.y) - 0.5, 0.0, float(size.y - 1));
  int x0 = int(floor(x)), y0 = int(floor(y));
  float fx = x - float(x0), fy = y - float(y0);
  int y1 = min(y0 + 1, size.y - 1);
  int x1 = (x0 + 1) % size.x;
  x0 = (x0 + size.x) % size.x;
  vec3 low = mix(texelFetch(picture, origin + ivec2(x0, y0), 0).rgb,
                 texelFetch(picture, origin + ivec2(x1, y0), 0).rgb, fx);
  vec3 high = mix(texelFetch(picture, origin + ivec2(x0, y1), 0).rgb,
                  texelFetch(picture, origin + ivec2(x1, y1), 0).rgb, fx);
  return mix(low, high, fy);
}

// Level 0 is the image, 1 .. PS_ROUGH_LEVELS are prefiltered, the next one is the irradiance / pi, and the last one is for gathers.
vec3 ps_environment_level(vec2 uv, int level)
{
  int height = textureSize(ps_environment, 0).y - 2 * PS_TILE_HEIGHT;
  if (level == 0) {
    return ps_equirectangular(ps_environment, ivec2(0), ivec2(int(texelFetch(ps_environment, ivec2(0), 0).a), height), uv);
  }
  ivec2 origin = ivec2((level - 1) % 4 * PS_TILE_WIDTH, height + (level - 1) / 4 * PS_TILE_HEIGHT);
  return ps_equirectangular(ps_environment, origin, ivec2(PS_TILE_WIDTH, PS_TILE_HEIGHT), uv);
}

// Blender's equirectangular layout.
vec2 ps_uv_from_direction(vec3 d)
{
  float azimuth = (d.x == 0.0 && d.y == 0.0) ? 0.0 : atan(d.y, d.x);
  return vec2(0.5 - azimuth / (2.0 * PS_PI), 0.5 + atan(d.z, length(d.xy)) / PS_PI);
}

vec3 ps_environment_radiance(vec3 direction_image, float roughness)
{
  float position = clamp(roughness / PS_ROUGH_STEP, 0.0, float(PS_ROUGH_LEVELS));
  int level = min(int(position), PS_ROUGH_LEVELS - 1);
  vec2 uv = ps_uv_from_direction(direction_image);
  return mix(ps_environment_level(uv, level), ps_environment_level(uv, level + 1), position - float(level));
}

#endif

// Radiance of the world itself along a ray in view space.
vec3 ps_background(vec3 direction)
{
#if !defined(PS_SHOWS_ENVIRONMENT)
  return vec3(0.0);
#elif defined(PS_HAS_ENVIRONMENT)
  return ps_environment_level(ps_uv_from_direction(ps_image_from_view(direction)), 0);
#elif defined(PS_HAS_WORLD)
  return texelFetch(ps_lights, ivec2(0, PS_WORLD_ROW), 0).rgb;
#else
  return vec3(0.0);
#endif
}

#if defined(PS_HAS_LIGHTS) || defined(PS_HAS_WORLD) || defined(PS_HAS_ENVIRONMENT) || defined(PS_INDIRECT)

// The world's mean radiance over the glossy lobe.
vec3 ps_mirrored_world(PsLobes lobes)
{
#if defined(PS_HAS_ENVIRONMENT)
  // A rough lobe leans from the mirror direction towards the normal (Lagarde and de Rousiers 2014, 4.9.3).
  float smoothness = 1.0 - lobes.alpha;
  vec3 direction = normalize(mix(lobes.reflecting, lobes.mirror, smoothness * (sqrt(smoothness) + lobes.alpha)));
  return ps_environment_radiance(ps_image_from_view(direction), lobes.roughness);
#elif defined(PS_HAS_WORLD)
  return texelFetch(ps_lights, ivec2(0, PS_WORLD_ROW), 0).rgb;
#else
  return vec3(0.0);
#endif
}

#ifdef PS_DIFFUSE_LOBES
#define PS_DIFFUSE_OF(lobes) (lobes).even
#else
#define PS_DIFFUSE_OF(lobes) (lobes).diffuse
#endif

#ifdef PS_INDIRECT
// What the surface receives from all others and from the sky that these leave open: shaders/indirect/interpolate.frag.
vec4 ps_gathered, ps_mirrored;

vec3 ps_shade_world(PsLobes lobes)
{
  return PS_DIFFUSE_OF(lobes) * ps_gathered.rgb +
         lobes.reflectance * (ps_mirrored.rgb + ps_mirrored.a * ps_mirrored_world(lobes));
}
#else
vec3 ps_shade_world(PsLobes lobes)
{
#if defined(PS_HAS_ENVIRONMENT)
  vec2 uv = ps_uv_from_direction(ps_image_from_view(lobes.normal));
  return PS_DIFFUSE_OF(lobes) * ps_environment_level(uv, PS_ROUGH_LEVELS + 1) + lobes.reflectance * ps_mirrored_world(lobes);
#elif defined(PS_HAS_WORLD)
  return (PS_DIFFUSE_OF(lobes) + lobes.reflectance) * ps_mirrored_world(lobes);
#else
  return vec3(0.0);
#endif
}
#endif

#endif
