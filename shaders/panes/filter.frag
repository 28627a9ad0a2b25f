// What panes change in the cells of a pixel and of its neighbours, by the weights of the pixel filter. Rows of ps_weights, texels
// of ps_members: as in translucent/difference_cells.frag. u.corner: where in the picture the tile begins. PS_CENTRED: ps_change is
// what is opaque, hidden; ps_bare is seen in its place without captured splats, and ps_seen with them. These have the pixel filter
// in them: their pixel sees the mean of its own cells, and what others show without them as far as they let it through.

#include "lib/visibility/lattice.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy) - u.corner;
  out_combined = vec4(0.0);
#ifdef PS_CENTRED
  vec4 bare = vec4(0.0);
  float weights = 0.0;
#endif
  for (int row = 0; row < u.neighbours; row++) {
    ivec2 at = pixel + ivec2(texelFetch(ps_weights, ivec2(0, row), 0).x, texelFetch(ps_weights, ivec2(1, row), 0).x);
    ivec2 central = ps_central_cell(clamp(at, ivec2(0), u.size - 1));
    for (int i = 0; i < u.sub_samples; i++) {
      ivec2 member = ivec2(texelFetch(ps_members, ivec2(i, 0), 0).yz);
      float weight = texelFetch(ps_weights, ivec2(3 + i, row), 0).x;
      out_combined += weight * texelFetch(ps_change, central + member, 0);
#ifdef PS_CENTRED
      bare += weight * texelFetch(ps_bare, central + member, 0);
      weights += weight;
#endif
    }
  }
#ifdef PS_CENTRED
  vec4 own = vec4(0.0), own_bare = vec4(0.0);
  float left = 0.0;
  ivec2 central = ps_central_cell(pixel);
  for (int i = 0; i < u.sub_samples; i++) {
    ivec2 cell = central + ivec2(texelFetch(ps_members, ivec2(i, 0), 0).yz);
    own += texelFetch(ps_seen, cell, 0);
    own_bare += texelFetch(ps_bare, cell, 0);
    left += texelFetch(ps_left, cell, 0).x;
  }
  float each = 1.0 / float(u.sub_samples);
  out_combined += weights * each * own + left * each * (bare - weights * each * own_bare);
#endif
}
