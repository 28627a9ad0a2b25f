// Reads a texel in the place of what the last dispatch has read: render/device/protocol.py, let_go.
void main() {
  imageAtomicMin(cell, ivec2(0), uint(texelFetch(ps_texel, ivec2(0), 0).x));
}
