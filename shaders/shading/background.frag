// The world where nothing else is, added to what earlier samples left. PS_EVERYWHERE: that is all of the picture.
// PS_AUXILIARY_ONLY: only passes beside Combined are drawn. PS_GROUPED: what lies behind open sub-samples, before these are
// spread; PS_MATTES: and behind mattes, wherever they are.
// PS_TRAINED: in display values, over which captured splats are blended.

#include "lib/geometry/camera.glsl"
#include "lib/light/lights.glsl"
#include "lib/fog/in_fog.glsl"
#include "lib/light/backdrop.glsl"
#include "lib/geometry/finite.glsl"
#ifdef PS_TRAINED
#include "lib/captured/display.glsl"
#endif
#if !defined(PS_EVERYWHERE) && !defined(PS_GROUPED)
#include "lib/geometry/surfel_kind.glsl"
#include "lib/geometry/coverage.glsl"
#endif
#ifdef PS_GROUPED
#include "lib/visibility/groups.glsl"
#endif

void main()
{
#if defined(PS_GROUPED)
  const float open = 1.0;
#ifndef PS_MATTES
  if ((texelFetch(ps_second, ivec2(gl_FragCoord.xy), 0).x & PS_OPEN) == 0u) {
    discard;
  }
#endif
#elif defined(PS_EVERYWHERE)
  const float open = 1.0;
#else
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  float open = 1.0 - ps_coverage(pixel, texelFetch(ps_centre, pixel, 0));
  if (open == 0.0) {
    discard;
  }
#endif
#if defined(PS_FOG) && !defined(PS_AUXILIARY_ONLY)
  vec4 behind = ps_behind_fog(gl_FragCoord.xy, u.light_count);
  out_combined = open * vec4(ps_finite(behind.rgb), behind.a);
#elif defined(PS_BACKDROP)
  out_combined = open * vec4(ps_finite(ps_backdrop_at(gl_FragCoord.xy)), 1.0);
#elif defined(PS_BACKGROUND)
  out_combined = open * vec4(ps_finite(ps_background(ps_ray(gl_FragCoord.xy))), 1.0);
#elif !defined(PS_AUXILIARY_ONLY)
  out_combined = vec4(0.0);
#endif
#ifdef PS_TRAINED
  out_combined.rgb = ps_display_from_linear(out_combined.rgb);
#endif
#ifdef PS_OUT_NORMAL
  out_normal_pass = vec4(0.0);
#endif
#ifdef PS_OUT_MIST
  out_mist = vec4(open);
#endif
}
