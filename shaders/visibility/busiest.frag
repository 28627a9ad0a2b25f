// The greatest number of groups among the pixels of each tile.

#include "lib/visibility/groups.glsl"

void main()
{
  ivec2 low = ivec2(gl_FragCoord.xy) * PS_TILE;
  ivec2 high = min(low + PS_TILE, textureSize(ps_second, 0));
  int most = 0;
  bool open = false;
  for (int y = low.y; y < high.y; y++) {
    for (int x = low.x; x < high.x; x++) {
      uint second = texelFetch(ps_second, ivec2(x, y), 0).x;
      most = max(most, ps_group_count(uvec2(0u, second)));
      open = open || (second & PS_OPEN) != 0u;
    }
  }
  out_count = float(most) + (open ? 0.5 : 0.0);
}
