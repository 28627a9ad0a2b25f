// Each invocation adds one to the pixel of its index.
#include "lib/data/index.glsl"

void main() {
  int index = ps_index();
  if (index >= u.count) return;
  int width = imageSize(counter).x;
  imageAtomicAdd(counter, ivec2(index % width, index / width), 1u);
}
