void main() {
#ifdef WRITE_DEPTH
  gl_FragDepth = 1.0 - gl_FragCoord.z;
#endif
#ifdef ADD
  color = vec4(level, 2.0 * level, -level, 1.0);
#else
  id = uint(index);
#endif
}
