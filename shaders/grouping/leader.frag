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
  uvec2 codes = uvec2(texelFetch(ps_first, listed.pixel, 0).x, texelFetch(ps_second, listed.pixel, 0).x);
  uvec2 members = (codes.y & PS_UNIFORM) != 0u ? uvec2(0u) : ps_group_members(codes, uint(listed.layer));
  ivec2 sum = ivec2(0);
  int count = 0;
  for (uvec2 left = members; (left.x | left.y) != 0u; count++) {
    sum += ps_next_member(left);
  }
  vec2 mean = vec2(sum) / float(max(count, 1));
  float least = 1e30;
  ivec2 cell = middle;
  for (uvec2 left = members; (left.x | left.y) != 0u;) {
    int number;
    ivec2 at = ps_next_member(left, number);
    vec2 away = vec2(at) - mean;
    bool nearer = dot(away, away) < least;
    chosen = nearer ? number : chosen;
    cell = nearer ? middle + at : cell;
    least = nearer ? dot(away, away) : least;
  }
#else
  ivec2 cell = middle;
#endif
  bool there = listed.layer >= 0;
  out_leader = there ? texelFetch(ps_ids, cell, 0).x : 0xFFFFFFFFu;
  out_depth = texelFetch(ps_depths, cell, 0).x;
  out_member = uint(chosen);
}
