// What translucent splats change in the sub-samples of the pixel and of its neighbours, by the weights of the pixel filter:
// what those show (ps_layer, one texel a cell, from u.corner on) less what is opaque in them. Rows of ps_weights as in
// difference.frag, of all sub-samples; texels of ps_members: each sub-sample's number and cell. PS_BEHIND: what open
// sub-samples show. PS_PLACES: groups are not listed in the order of their pixels. PS_PART: only in pixels where ps_part is
// not 0.

#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy), last = textureSize(ps_first, 0) - 1;
  out_difference = vec4(0.0);
#ifdef PS_PART
  if (texelFetch(ps_part, pixel, 0).x == 0.0) {
    discard;
  }
#endif
  for (int row = 0; row < u.neighbours; row++) {
    ivec2 at = pixel + ivec2(texelFetch(ps_weights, ivec2(0, row), 0).x, texelFetch(ps_weights, ivec2(1, row), 0).x);
    at = clamp(at, ivec2(0), last);
    uvec2 codes = uvec2(texelFetch(ps_first, at, 0).x, texelFetch(ps_second, at, 0).x);
    ivec2 central = ps_central_cell(at) - u.corner;
    vec4 shares = vec4(0.0), shown = vec4(0.0);  // weights of the groups
    float open_share = 0.0;
    for (int i = 0; i < u.sub_samples; i++) {
      vec4 member = texelFetch(ps_members, ivec2(i, 0), 0);
      float weight = texelFetch(ps_weights, ivec2(3 + i, row), 0).x;
      ivec2 cell = central + ivec2(member.yz);
      vec4 seen = texelFetch(ps_layer, cell, 0);
#ifdef PS_HOLDOUT
      seen.w = max(seen.w - texelFetch(ps_cut, cell, 0).y, 0.0);
#endif
      shown += weight * seen;
      uint group = ps_group(codes, int(member.x));
      shares += weight * vec4(equal(uvec4(group), uvec4(0u, 1u, 2u, 3u)));
      open_share += group == PS_NO_GROUP ? weight : 0.0;
    }
    int first = int(texelFetch(ps_starts, at, 0).x), count = ps_group_count(codes);
    for (int group = 0; group < count; group++) {
      shown -= shares[group] * texelFetch(ps_combined, ps_group_texel(first + group), 0);
    }
#ifdef PS_BEHIND
    shown -= open_share * texelFetch(ps_behind, at, 0);
#endif
    out_difference += shown;
  }
}
