// The sub-sample that stands for each group of the list: the one nearest to the mean of all of the group. PS_CENTRAL: instead,
// that at each pixel's centre.

#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/visibility/listed.glsl"

void main()
{
  PsListed listed = ps_listed(ivec2(gl_FragCoord.xy));
  ivec2 middle = ps_central_cell(listed.pixel);
  int chosen = 0;
#ifndef PS_CENTRAL
  const ivec2 cells[PS_SUB_SAMPLES] = PS_CELLS;
  uvec2 codes = uvec2(texelFetch(ps_first, listed.pixel, 0).x, texelFetch(ps_second, listed.pixel, 0).x);
  int members = (codes.y & PS_UNIFORM) != 0u ? 0 : PS_SUB_SAMPLES;
  ivec2 sum = ivec2(0);
  int count = 0;
  for (int i = 0; i < members; i++) {
    bool mine = ps_group(codes, i) == uint(listed.layer);
    sum += mine ? cells[i] : ivec2(0);
    count += mine ? 1 : 0;
  }
  float least = 1e30;
  for (int i = 0; i < members; i++) {
    vec2 away = vec2(cells[i]) - vec2(sum) / float(max(count, 1));
    bool nearer = ps_group(codes, i) == uint(listed.layer) && dot(away, away) < least;
    chosen = nearer ? i : chosen;
    least = nearer ? dot(away, away) : least;
  }
  ivec2 cell = middle + cells[chosen];
#else
  ivec2 cell = middle;
#endif
  bool there = listed.layer >= 0;
  out_leader = there ? texelFetch(ps_ids, cell, 0).x : 0xFFFFFFFFu;
  out_depth = texelFetch(ps_depths, cell, 0).x;
  out_member = uint(chosen);
}
