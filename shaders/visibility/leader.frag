// The sub-sample that stands for each pixel's group u.layer: the one nearest to the mean of all of the group. PS_CENTRAL:
// instead, the sub-sample at the pixel's centre.

#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy), middle = ps_central_cell(pixel);
  int chosen = 0;
#ifndef PS_CENTRAL
  const ivec2 cells[PS_SUB_SAMPLES] = PS_CELLS;
  uvec2 codes = uvec2(texelFetch(ps_first, pixel, 0).x, texelFetch(ps_second, pixel, 0).x);
  ivec2 sum = ivec2(0);
  int count = 0;
  for (int i = 0; i < PS_SUB_SAMPLES; i++) {
    bool mine = ps_group(codes, i) == uint(u.layer);
    sum += mine ? cells[i] : ivec2(0);
    count += mine ? 1 : 0;
  }
  float least = 1e30;
  chosen = -1;
  for (int i = 0; i < PS_SUB_SAMPLES; i++) {
    vec2 away = vec2(cells[i]) - vec2(sum) / float(max(count, 1));
    bool nearer = ps_group(codes, i) == uint(u.layer) && dot(away, away) < least;
    chosen = nearer ? i : chosen;
    least = nearer ? dot(away, away) : least;
  }
  ivec2 cell = middle + cells[max(chosen, 0)];
#else
  ivec2 cell = middle;
#endif
  out_leader = chosen < 0 ? 0xFFFFFFFFu : texelFetch(ps_ids, cell, 0).x;
  out_depth = texelFetch(ps_depths, cell, 0).x;
  out_member = uint(max(chosen, 0));
}
