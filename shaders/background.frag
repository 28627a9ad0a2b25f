// The world where nothing else is, added to what earlier samples left.

#include "lib/camera.glsl"
#include "lib/place.glsl"
#include "lib/lights.glsl"
#include "lib/finite.glsl"
#include "lib/coverage.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  float open = 1.0 - ps_coverage(pixel, texelFetch(ps_place, pixel, 0));
  if (open == 0.0) {
    discard;
  }
#ifdef PS_BACKGROUND
  out_combined = open * vec4(ps_finite(ps_background(ps_ray(gl_FragCoord.xy))), 1.0);
#else
  out_combined = vec4(0.0);
#endif
#ifdef PS_OUT_NORMAL
  out_normal_pass = vec4(0.0);
#endif
#ifdef PS_OUT_ALBEDO
  out_albedo = vec4(0.0);
#endif
#ifdef PS_OUT_MIST
  out_mist = vec4(open);
#endif
}
