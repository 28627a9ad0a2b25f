#include "lib/data/index.glsl"

void main() {
  int index = ps_index();
  ivec2 size = imageSize(result);
  if (index >= size.x * size.y) return;
  ivec2 pixel = ivec2(index % size.x, index / size.x);
  imageStore(result, pixel, 2.0 * imageLoad(result, pixel) + vec4(pixel, index, 1.0));
}
