// A triangle over the whole target, and a colour at each corner.
void main() {
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
  shade = vec4(gl_VertexID == 0, gl_VertexID == 1, gl_VertexID == 2, 1.0);
  number = 7;
}
