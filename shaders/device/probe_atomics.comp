// Asks a device whether atomics on an image work: the least of 7, 8, 9, ... must remain.
#include "lib/data/index.glsl"

void main() {
  imageAtomicMin(cell, ivec2(0, 0), uint(7 + ps_index()));
}
