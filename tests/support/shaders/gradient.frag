void main() {
  first = shade;
  second = vec4(0.5, 1.0, float(number), FACTOR);
  third = uint(gl_FragCoord.x) + 1000u * uint(gl_FragCoord.y);
  fourth = gl_FragCoord.x;
}
