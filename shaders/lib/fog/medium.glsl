// Light that media scatter: of lamps once, and what else falls on them. For lights.glsl. PS_GATHERED_MEDIUM: that is known, with
// all bounces (render/indirect/media.py); else it is that of the world, which nothing hides.

#define PS_DEEPEST_PIECE 1.5  // deeper pieces are taken as this one: their middles' light is known less well

#ifdef PS_HAS_LIGHTS

// Henyey and Greenstein 1941; `cosine` of the angle by which light turns.
float ps_phase(float g, float cosine)
{
  float base = max(1.0 + g * g - 2.0 * g * cosine, 1e-6);
  return (1.0 - g * g) / (4.0 * PS_PI * base * sqrt(base));
}

// Irradiance of a small ball, over its cross-section, by one light; to_light points at the light's centre.
vec3 ps_ball_irradiance(int index, ivec4 ends, vec3 position, out vec3 to_light)
{
  vec4 color = ps_light(index, 0), light_position = ps_light(index, 1), direction = ps_light(index, 2);
  to_light = light_position.xyz;
  if (index < ends.x) {
    return color.rgb;
  }
  vec3 offset = light_position.xyz - position;
  float d2 = max(dot(offset, offset), 1e-24);
  to_light = offset * inversesqrt(d2);
  float share = 1.0 / (direction.w > 0.0 ? d2 + direction.w * direction.w : max(d2, direction.w * direction.w));
#ifdef PS_HAS_SPOTS
  if (index >= ends.y && index < ends.z) {
    share *= ps_cone(ps_cone_of(index), -offset, 0.0);
  }
#endif
#ifdef PS_HAS_AREA_LIGHTS
  if (index >= ends.z) {
    PsArea area = ps_area(index, offset);
    share = ps_rectangle_solid_angle(area) * (index < ends.w ? 1.0 : PS_PI / 4.0);
    float facing = -dot(to_light, area.direction);
    share *= facing > 0.0 ? ps_beam(area, facing) : 0.0;
  }
#endif
  return color.rgb * share;
}

#endif

// The mean radiance of the world.
vec3 ps_ambient()
{
#if defined(PS_HAS_ENVIRONMENT)
  // Irradiances from both sides, over pi, make the mean along each axis.
  vec3 sum = vec3(0.0);
  for (int i = 0; i < 6; i++) {
    vec3 axis = (i % 2 == 0 ? 1.0 : -1.0) * vec3(equal(ivec3(i / 2), ivec3(0, 1, 2)));
    sum += ps_environment_level(ps_uv_from_direction(axis), PS_ROUGH_LEVELS + 1);
  }
  return sum / 6.0;
#elif defined(PS_HAS_WORLD)
  return texelFetch(ps_lights, ivec2(0, PS_WORLD_ROW), 0).rgb;
#else
  return vec3(0.0);
#endif
}

#ifdef PS_GATHERED_MEDIUM
#include "lib/indirect/medium_light.glsl"
#endif

// Light that a medium of this albedo scatters once towards the eye, over its extinction; g is Henyey and Greenstein's.
// across: optical depth of the piece of the medium that the light of its middle stands for. Light from the eye's side is
// brightest where the eye sees most of the piece, and the mean of what is seen is more than the middle's: by exp((1 + 2 c) d^2 / 24)
// for the product of exponentials in a cube of depth d, lit from a direction at an angle of cosine c to that of the eye. Along the eye's
// direction that is cosh(d / 2), which it follows for larger depths.
vec3 ps_shade_medium(vec3 position, vec3 to_eye, float g, vec3 albedo, vec3 across, int light_count)
{
#ifdef PS_SHOWS_VOLUME
  vec3 half_depth = 0.5 * min(across, vec3(PS_DEEPEST_PIECE)), steep = log(0.5 * (exp(half_depth) + exp(-half_depth))) / 3.0;
#ifdef PS_GATHERED_MEDIUM
  vec3 result = ps_medium_light(position);
#else
  vec3 result = ps_ambient();
#endif
#ifdef PS_HAS_LIGHTS
  ivec4 ends = ps_light_ends();
  for (int i = 0; i < light_count; i++) {
    vec3 to_light;
    vec3 irradiance = ps_ball_irradiance(i, ends, position, to_light);
    irradiance = ps_reaching(i, irradiance, position, vec3(0.0));
    float cosine = dot(to_light, to_eye);
    result += irradiance * ps_phase(g, -cosine) * exp(steep * (1.0 + 2.0 * cosine));
  }
#endif
  return albedo * result;
#else
  return vec3(0.0);
#endif
}
