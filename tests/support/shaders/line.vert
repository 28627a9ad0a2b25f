// Line i runs through the centres of row 2 i + 1 of 16 x 16 pixels, from within column 2 to within
// column 14. A line draws the pixels whose diamond it leaves: 2 to 13.
void main() {
  float x = gl_VertexID % 2 == 0 ? 2.05 : 14.05;
  float y = 2.0 * float(gl_VertexID / 2) + 1.5;
  gl_Position = vec4(x / 8.0 - 1.0, y / 8.0 - 1.0, 0.0, 1.0);
}
