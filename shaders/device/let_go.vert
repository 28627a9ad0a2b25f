// One triangle that covers all, and reads a texel in the place of what the last draw's vertices have read.
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0;
  gl_Position = vec4(corner, texelFetch(ps_texel, ivec2(0), 0).x, 1.0);
}
