// One pixel for each field of the block, four for the matrix.
void main() {
  int x = int(gl_FragCoord.x);
  vec4 values[11];
  values[0] = vec4(u.a, 0.0, 0.0, 0.0);
  values[1] = vec4(u.b, 0.0, 0.0);
  values[2] = vec4(float(u.c), float(u.d), 0.0, 0.0);
  values[3] = u.e;
  values[4] = vec4(u.f, 0.0, 0.0, 0.0);
  values[5] = u.g[0];
  values[6] = u.g[1];
  values[7] = u.g[2];
  values[8] = u.g[3];
  values[9] = vec4(vec2(u.h), u.k, 0.0);
  values[10] = vec4(u.j);
  color = values[x];
}
