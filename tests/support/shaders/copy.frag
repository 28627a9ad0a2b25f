void main() {
  color = texelFetch(source, ivec2(gl_FragCoord.xy), 0);
}
