// The sum over all lights, each times the share of it that reaches the point. For lights.glsl.

#ifdef PS_HAS_LIGHTS

// Share of the light that light `index` sends to a point in view space which reaches it; the normal is 0 in a medium.
#ifdef PS_REACHED
vec3 ps_reached[4];  // known before
#endif

#ifdef PS_SHADOWED
vec3 ps_arrived;  // the sum of all light, without shadows
#endif

vec3 ps_reaching(int index, vec3 light, vec3 position, vec3 normal)
{
#ifdef PS_FOG
  light *= index < ps_light_ends().x ? vec3(1.0) : ps_fog_left(length(ps_light(index, 1).xyz - position));
#endif
#ifdef PS_SHADOWED
  ps_arrived += light;
#endif
#if defined(PS_REACHED)
  return light * ps_reached[index];
#elif defined(PS_SHADOWS)
#ifdef PS_FOOTPRINT
  vec3 there = ps_light(index, 1).xyz;
  ps_raise(index < ps_light_ends().x ? there : normalize(there - position), normal);
  position += ps_footprint.raised;
#endif
  return light * ps_transmittance(index, position, normal, any(greaterThan(light, vec3(0.0))));
#else
  return light;
#endif
}

#ifdef PS_COAT
#define PS_LAYERS(surface, coat) (surface) + (coat)
#else
#define PS_LAYERS(surface, coat) (surface)
#endif

vec3 ps_shade_lights(vec3 position, PsLobes lobes, int light_count)
{
  vec3 result = vec3(0.0);
  int i = 0;
#ifdef PS_ONE_KIND
  ivec4 ends = ivec4(light_count);
#else
  ivec4 ends = ps_light_ends();
#endif
#ifdef PS_HAS_SUNS
  for (; i < ends.x; i++) {
    vec3 light = PS_LAYERS(ps_sun(i, lobes), ps_sun(i, ps_coated));
    result += ps_reaching(i, light, position, lobes.normal);
#ifdef PS_BACKLIT
    result += ps_reaching(i, ps_sun(i, ps_behind_lobes), position, -lobes.normal);
#endif
  }
#endif
#ifdef PS_HAS_POINTS
  for (; i < ends.y; i++) {
    vec3 light = PS_LAYERS(ps_point(i, position, lobes), ps_point(i, position, ps_coated));
    result += ps_reaching(i, light, position, lobes.normal);
#ifdef PS_BACKLIT
    result += ps_reaching(i, ps_point(i, position, ps_behind_lobes), position, -lobes.normal);
#endif
  }
#endif
#ifdef PS_HAS_SPOTS
  for (; i < ends.z; i++) {
    vec3 light = PS_LAYERS(ps_spot(i, position, lobes), ps_spot(i, position, ps_coated));
    result += ps_reaching(i, light, position, lobes.normal);
#ifdef PS_BACKLIT
    result += ps_reaching(i, ps_spot(i, position, ps_behind_lobes), position, -lobes.normal);
#endif
  }
#endif
#ifdef PS_HAS_RECTANGLES
  for (; i < ends.w; i++) {
    vec3 light = PS_LAYERS(ps_area_light(i, false, position, lobes), ps_area_light(i, false, position, ps_coated));
    result += ps_reaching(i, light, position, lobes.normal);
#ifdef PS_BACKLIT
    result += ps_reaching(i, ps_area_light(i, false, position, ps_behind_lobes), position, -lobes.normal);
#endif
  }
#endif
#ifdef PS_HAS_ELLIPSES
  for (; i < light_count; i++) {
    vec3 light = PS_LAYERS(ps_area_light(i, true, position, lobes), ps_area_light(i, true, position, ps_coated));
    result += ps_reaching(i, light, position, lobes.normal);
#ifdef PS_BACKLIT
    result += ps_reaching(i, ps_area_light(i, true, position, ps_behind_lobes), position, -lobes.normal);
#endif
  }
#endif
  return result;
}

#endif
