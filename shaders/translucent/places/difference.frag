// What translucent splats change in a pixel, from what they change at its places and at its neighbours' (ps_change, one texel
// a cell, from u.corner on). Rows of ps_weights as in translucent/difference.frag; texels of ps_members: each place's number
// and cell. PS_PART: only in pixels where ps_part is not 0.

#include "lib/visibility/lattice.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy), last = u.size_of_tile - 1;
  out_difference = vec4(0.0);
#ifdef PS_PART
  if (texelFetch(ps_part, pixel, 0).x == 0.0) {
    discard;
  }
#endif
  for (int row = 0; row < u.neighbours; row++) {
    ivec2 at = pixel + ivec2(texelFetch(ps_weights, ivec2(0, row), 0).x, texelFetch(ps_weights, ivec2(1, row), 0).x);
    ivec2 central = ps_central_cell(clamp(at, ivec2(0), last)) - u.corner;
    vec4 sum = vec4(0.0);  // of one neighbour: of many terms in one sum the last digits would be lost
    for (int i = 0; i < u.sub_samples; i++) {
      ivec2 cell = central + ivec2(texelFetch(ps_members, ivec2(i, 0), 0).yz);
      float weight = texelFetch(ps_weights, ivec2(3 + i, row), 0).x;
      sum += weight * texelFetch(ps_change, cell, 0);
    }
    out_difference += sum;
  }
}
