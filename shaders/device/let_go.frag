// Reads a texel in the place of what the last draw has read: render/device/protocol.py, let_go.
void main() {
  color = texelFetch(ps_texel, ivec2(0), 0);
}
