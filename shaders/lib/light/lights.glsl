// Direct light in view space; the entry is ps_shade. Layout of ps_lights: core/light/light_table.py; float64 twin and
// sources: tests/reference/lighting.py.
// Names say what a scene needs, and all else is left out: PS_HAS_SUNS, PS_HAS_POINTS, PS_HAS_SPOTS, PS_HAS_RECTANGLES,
// PS_HAS_ELLIPSES (kinds of lights), PS_ONE_KIND (all lights are of one); PS_HAS_WIDE_LIGHTS (some light's size is
// seen), PS_HAS_BEAMS (narrowed area lights), PS_HAS_METAL, PS_COAT, PS_BACKLIT, PS_ONE_SURFACE, PS_HAS_WORLD,
// PS_HAS_ENVIRONMENT, PS_FOG. Some devices run both sides of every branch, so work that not all pixels need stands in
// loops of as many turns as a pixel needs.

#if defined(PS_HAS_SUNS) || defined(PS_HAS_POINTS) || defined(PS_HAS_SPOTS)
#define PS_HAS_ROUND_LIGHTS
#endif
#if defined(PS_HAS_RECTANGLES) || defined(PS_HAS_ELLIPSES)
#define PS_HAS_AREA_LIGHTS
#endif
#if defined(PS_HAS_ROUND_LIGHTS) || defined(PS_HAS_AREA_LIGHTS)
#define PS_HAS_LIGHTS
#endif

#include "lib/light/brdf.glsl"
#include "lib/light/environment.glsl"
#include "lib/light/emitted.glsl"
#include "lib/shadow/shadow.glsl"
#include "lib/light/lobe_share.glsl"
#include "lib/light/round_lights.glsl"
#include "lib/light/area_irradiance.glsl"
#include "lib/light/area_lights.glsl"
#include "lib/fog/fog.glsl"
#include "lib/light/light_loop.glsl"
#include "lib/fog/medium.glsl"

#ifdef PS_TERM_OCCLUSION
// What a surface receives of a white world alone.
vec3 ps_unoccluded()
{
#ifdef PS_INDIRECT
  return min(ps_gathered.rgb, 1.0);
#else
  return vec3(1.0);
#endif
}
#endif

// Radiance towards the eye at a point in view space. normal and to_eye are unit; the normal is that of the side that is
// seen. plane: the unit normal of the surface's plane, turned to the eye, where that is not `normal`; else (0, 0, 0).
// light_count: how many rows of lights ps_lights holds.
vec3 ps_shade(vec3 position, vec3 normal, vec3 plane, vec3 to_eye, PsSurface surface, int light_count)
{
#if defined(PS_TERM_OCCLUSION)
  vec3 result = ps_unoccluded();
#elif defined(PS_SHOWS_EMISSION)
  vec3 result = surface.emission;
#else
  vec3 result = vec3(0.0);
#endif
#if !defined(PS_TERM_OCCLUSION) && (defined(PS_HAS_LIGHTS) || defined(PS_HAS_WORLD) || defined(PS_HAS_ENVIRONMENT) || defined(PS_INDIRECT))
  PsLobes lobes = ps_lobes(surface, normal, plane, to_eye);
#ifdef PS_ROUGH_DIFFUSE
  ps_roughen(lobes, surface.base, ps_diffuse_roughness);
#endif
#ifdef PS_TOON
  lobes.toon = ps_toon;
#endif
#ifdef PS_COAT
#ifdef PS_SPREAD
  ps_coated = ps_coat_lobes(normal, plane, to_eye, surface.spread);
#else
  ps_coated = ps_coat_lobes(normal, plane, to_eye, 0.0);
#endif
  vec3 left = ps_below_coat(ps_coated);
  lobes = ps_covered_lobes(lobes, left);
  result *= left;
#endif
#ifdef PS_SHEEN
  PsLobes clothed = lobes;
  ps_clothe(clothed, ps_sheen.rgb, ps_sheen.a);
  vec3 among = vec3(1.0 - min(ps_most(clothed.fibres), 1.0));
  lobes = ps_covered_lobes(lobes, among);
  lobes.fibres = clothed.fibres;
  lobes.bend = clothed.bend;
  lobes.even += lobes.fibres;
  result *= among;
#ifdef PS_COAT
  ps_coated = ps_covered_lobes(ps_coated, among);
#endif
#endif
#if defined(PS_COAT) && defined(PS_TERM)
  ps_keep_term(ps_coated);
#endif
#ifdef PS_TERM
  ps_keep_term(lobes);
#endif
#if defined(PS_TERM_COLOR)
#ifdef PS_COAT
  result += ps_coated.reflectance;
#endif
  result += lobes.diffuse + lobes.reflectance;
#ifdef PS_SHEEN
  result += lobes.fibres;
#endif
#elif defined(PS_SHOWS_SURFACES)
#ifdef PS_COAT
  result += ps_shade_world(ps_coated);
#endif
#ifdef PS_BACKLIT
  ps_divide_diffuse(lobes);
  result += ps_shade_world(ps_behind_lobes);
#endif
#ifdef PS_HAS_LIGHTS
  result += ps_shade_lights(position, lobes, light_count);
#endif
  result += ps_shade_world(lobes);
#endif
#endif
  return result;
}
