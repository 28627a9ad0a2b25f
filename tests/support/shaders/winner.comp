// The lowest index among the points that have that depth.
#include "lib/data/index.glsl"

void main() {
  int index = ps_index();
  if (index >= u.count) return;
  int width = textureSize(points, 0).x;
  vec4 point = texelFetch(points, ivec2(index % width, index / width), 0);
  if (texelFetch(depth, ivec2(point.xy), 0).r == floatBitsToUint(point.z)) {
    imageAtomicMin(id, ivec2(point.xy), uint(index));
  }
}
