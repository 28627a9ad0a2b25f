// The mean of a sharp picture over the disk of confusion. u.radius: its radii in texels. u.margin: texels
// around the blurred picture. Reference: tests/reference/backdrop.py, `blur_backdrop`.

void main()
{
  vec2 radius = u.radius;
  ivec2 middle = ivec2(gl_FragCoord.xy) + u.margin;
  int rows = int(radius.y) + 1;
  vec4 sum = vec4(0.0);
  for (int y = -rows; y <= rows; y++) {
    float row = float(y) / radius.y;
    int columns = int(radius.x * sqrt(max(1.0 - row * row, 0.0))) + 1;
    for (int x = -columns; x <= columns; x++) {
      vec2 offset = vec2(float(x), float(y));
      float away = max(length(offset / radius), 1e-6);
      float rim = x == 0 && y == 0 ? min(radius.x, radius.y) : length(offset) * (1.0 / away - 1.0);
      sum += clamp(rim + 0.5, 0.0, 1.0) * vec4(texelFetch(ps_sharp, middle + ivec2(x, y), 0).rgb, 1.0);
    }
  }
  out_color = vec4(sum.rgb / sum.a, 1.0);
}
