// What the eye sees through the world's fog. Beside lights.glsl, for passes that have the camera.

#ifdef PS_FOG

#include "lib/fog/airlight.glsl"

// Where between two places along a ray shadows are looked up, by the pixel (Jimenez 2014); samples of a picture differ.
float ps_fog_jitter(vec2 at)
{
  vec2 p = floor(at) + 5.588238 * floor(16.0 * fract(u.principal_point));
  return fract(52.9829189 * fract(dot(p, vec2(0.06711056, 0.00583715))));
}

// A ray from the plane before the eye at which the fog begins, as in Cycles.
vec3 ps_fog_origin(vec3 position, vec3 direction)
{
  float begin = ps_fog_texel(0).w;
  return ps_is_perspective() ? direction * (begin / max(-direction.z, 1e-6)) : vec3(position.xy, -begin);
}

// The radiance of something at a position in view space, as the eye sees it.
vec3 ps_in_fog(vec3 radiance, vec3 position, vec2 at, int light_count)
{
  vec3 direction = ps_is_perspective() ? normalize(position) : vec3(0.0, 0.0, -1.0);
  vec3 origin = ps_fog_origin(position, direction);
  float far = max(dot(position - origin, direction), 0.0);
  return ps_fog_left(far) * radiance + ps_airlight(origin, direction, far, ps_fog_jitter(at), light_count);
}

// Radiance and alpha of what lies behind all else in a pixel: the fog, and the world where it lets that through.
vec4 ps_behind_fog(vec2 at, int light_count)
{
  vec3 direction = ps_ray(at), origin = ps_fog_origin(ps_view_from_pixel(at, 0.0), direction);
  vec3 airlight = ps_airlight(origin, direction, 1e30, ps_fog_jitter(at), light_count);
#ifdef PS_BACKGROUND
  return vec4(airlight + ps_background(direction) * vec3(lessThanEqual(ps_fog_texel(0).rgb, vec3(0.0))), 1.0);
#else
  return vec4(airlight, dot(vec3(greaterThan(ps_fog_texel(0).rgb, vec3(0.0))), vec3(1.0 / 3.0)));
#endif
}

#endif
