// Light on captured splats (render/passes/captured/project.py). PS_SHADOWED: of what reaches a white, dull surface without
// shadows, the share that what casts shadows leaves, by which the captured light is multiplied. Else PS_RELIT: the radiance of
// such a surface, which the captured colour is the albedo of. After lights.glsl.

#define PS_LIFT 2.0  // standard deviations: of a captured surface, splats lie so far above and below each other

vec3 ps_captured_light(vec3 position, vec3 normal, vec3 to_eye, int light_count)
{
#if defined(PS_SHADOWED) && !defined(PS_HAS_LIGHTS)
  return vec3(1.0);
#elif defined(PS_HAS_LIGHTS) || defined(PS_HAS_WORLD) || defined(PS_HAS_ENVIRONMENT)
  PsLobes lobes = ps_lobes(PsSurface(vec3(1.0), vec3(0.0), 1.0, 0.0, 1.0), normal, vec3(0.0), to_eye);
  lobes.diffuse = vec3(1.0);
  ps_leave_out_glossy(lobes);
  ps_keep_lambert(lobes);
  vec3 lit = ps_shade_world(lobes);
#ifdef PS_SHADOWED
  ps_arrived = lit;
#endif
#ifdef PS_HAS_LIGHTS
  lit += ps_shade_lights(position, lobes, light_count);
#endif
#ifdef PS_SHADOWED
  return mix(vec3(1.0), lit / max(ps_arrived, 1e-20), vec3(greaterThan(ps_arrived, vec3(0.0))));
#else
  return lit;
#endif
#else
  return vec3(0.0);
#endif
}
