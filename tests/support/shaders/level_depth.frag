void main() {
  gl_FragDepth = level;
  id = uint(index);
}
