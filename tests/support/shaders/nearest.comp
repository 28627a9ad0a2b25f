// The least depth of the points that fall into each pixel.
#include "lib/data/index.glsl"

void main() {
  int index = ps_index();
  if (index >= u.count) return;
  int width = textureSize(points, 0).x;
  vec4 point = texelFetch(points, ivec2(index % width, index / width), 0);
  imageAtomicMin(depth, ivec2(point.xy), floatBitsToUint(point.z));
}
