// The farthest depth of all sub-samples of each block of pixels; where one is open, that of what is infinitely far away.

#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"

void main()
{
  ivec2 first = PS_BLOCK_SIDE * ivec2(gl_FragCoord.xy), end = min(first + PS_BLOCK_SIDE, u.size);
  uint farthest = 0u;
  for (int y = first.y; y < end.y; y++) {
    for (int x = first.x; x < end.x; x++) {
      ivec2 middle = ps_central_cell(ivec2(x, y));
      for (int i = 0; i < PS_SUB_SAMPLES; i++) {
        farthest = max(farthest, texelFetch(ps_depths, middle + ps_sub_sample_cell(i), 0).x);
      }
    }
  }
  out_farthest = farthest;
}
