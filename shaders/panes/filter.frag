// What panes change in the cells of a pixel and of its neighbours, by the weights of the pixel filter. Rows of ps_weights, texels
// of ps_members: as in translucent/difference_cells.frag. u.corner: where in the picture the tile begins. PS_CENTRED:
// ps_seen is seen in the cells, and ps_change hidden; in tiles where ps_centred is not 0, a pixel sees the mean of its own cells.

#include "lib/visibility/lattice.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy) - u.corner;
  out_combined = vec4(0.0);
#ifdef PS_CENTRED
  bool centred = texelFetch(ps_centred, pixel / PS_TILE, 0).x != 0.0;
  float weights = 0.0;
#endif
  for (int row = 0; row < u.neighbours; row++) {
    ivec2 at = pixel + ivec2(texelFetch(ps_weights, ivec2(0, row), 0).x, texelFetch(ps_weights, ivec2(1, row), 0).x);
    at = clamp(at, ivec2(0), u.size - 1);
    ivec2 central = ps_central_cell(at);
#ifdef PS_CENTRED
    // No pane reaches the rim of these tiles: beside them nothing is changed by what they show.
    bool beside = !centred && texelFetch(ps_centred, at / PS_TILE, 0).x != 0.0;
#endif
    for (int i = 0; i < u.sub_samples; i++) {
      ivec2 member = ivec2(texelFetch(ps_members, ivec2(i, 0), 0).yz);
      float weight = texelFetch(ps_weights, ivec2(3 + i, row), 0).x;
#ifdef PS_CENTRED
      weights += weight;
      weight = beside ? 0.0 : weight;
      if (!centred) {
        out_combined += weight * texelFetch(ps_seen, central + member, 0);
      }
#endif
      out_combined += weight * texelFetch(ps_change, central + member, 0);
    }
  }
#ifdef PS_CENTRED
  vec4 own = vec4(0.0);
  for (int i = 0; i < (centred ? u.sub_samples : 0); i++) {
    own += texelFetch(ps_seen, ps_central_cell(pixel) + ivec2(texelFetch(ps_members, ivec2(i, 0), 0).yz), 0);
  }
  out_combined += own * (weights / float(u.sub_samples));
#endif
}
