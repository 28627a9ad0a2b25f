// What panes change in the cells of a pixel and of its neighbours, by the weights of the pixel filter. Rows of ps_weights, texels
// of ps_members: as in translucent/difference_cells.frag. u.corner: where in the picture the tile begins.

#include "lib/visibility/lattice.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy) - u.corner;
  out_combined = vec4(0.0);
  for (int row = 0; row < u.neighbours; row++) {
    ivec2 at = pixel + ivec2(texelFetch(ps_weights, ivec2(0, row), 0).x, texelFetch(ps_weights, ivec2(1, row), 0).x);
    ivec2 central = ps_central_cell(clamp(at, ivec2(0), u.size - 1));
    for (int i = 0; i < u.sub_samples; i++) {
      ivec2 member = ivec2(texelFetch(ps_members, ivec2(i, 0), 0).yz);
      out_combined += texelFetch(ps_weights, ivec2(3 + i, row), 0).x * texelFetch(ps_change, central + member, 0);
    }
  }
}
