// Two triangles: the left one counterclockwise, the right one clockwise. Coordinates avoid pixel centres.
void main() {
  vec2 corners[6] = vec2[6](vec2(-0.9, -0.9), vec2(-0.1, -0.9), vec2(-0.5, 0.9),
                            vec2(0.1, -0.9), vec2(0.5, 0.9), vec2(0.9, -0.9));
  gl_Position = vec4(corners[gl_VertexID], 0.0, 1.0);
}
