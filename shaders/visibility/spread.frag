// Spreads the shaded groups u.layer over the picture by the pixel filter: each pixel takes from its eight neighbours and
// from itself what their sub-samples of the group weigh. Layer 7: what nothing covers. PS_AUXILIARY_ONLY: not Combined.

#include "lib/visibility/groups.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy), last = textureSize(ps_second, 0) - 1;
  uint layer = uint(u.layer);
#ifndef PS_AUXILIARY_ONLY
  out_combined = vec4(0.0);
#endif
#ifdef PS_OUT_NORMAL
  out_normal_pass = vec4(0.0);
#endif
#ifdef PS_OUT_ALBEDO
  out_albedo = vec4(0.0);
#endif
#ifdef PS_OUT_MIST
  out_mist = vec4(0.0);
#endif
  for (int q = 0; q < 9; q++) {
    ivec2 at = clamp(pixel + ivec2(q % 3, q / 3) - 1, ivec2(0), last);
    uint second = texelFetch(ps_second, at, 0).x;
    bool here = layer == PS_NO_GROUP ? (second & PS_OPEN) != 0u : ps_group_count(uvec2(0u, second)) > u.layer;
    bool whole = here && (second & PS_UNIFORM) != 0u;
    float weight = whole ? texelFetch(ps_weights, ivec2(PS_SUB_SAMPLES, q), 0).x : 0.0;
    int some = here && !whole ? PS_SUB_SAMPLES : 0;
    uvec2 codes = uvec2(0u, second);
    if (some > 0) {
      codes.x = texelFetch(ps_first, at, 0).x;
    }
    for (int i = 0; i < some; i++) {
      weight += ps_group(codes, i) == layer ? texelFetch(ps_weights, ivec2(i, q), 0).x : 0.0;
    }
    if (weight > 0.0) {
#ifndef PS_AUXILIARY_ONLY
      out_combined += weight * texelFetch(ps_combined, at, 0);
#endif
#ifdef PS_OUT_NORMAL
      out_normal_pass += weight * texelFetch(ps_normal_pass, at, 0);
#endif
#ifdef PS_OUT_ALBEDO
      out_albedo += weight * texelFetch(ps_albedo, at, 0);
#endif
#ifdef PS_OUT_MIST
      out_mist += weight * texelFetch(ps_mist, at, 0);
#endif
    }
  }
}
