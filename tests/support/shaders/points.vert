// Texel i of `source`: x, y in clip space, z in [-1, 1], and the colour's level.
void main() {
  int width = textureSize(source, 0).x;
  vec4 point = texelFetch(source, ivec2(gl_VertexID % width, gl_VertexID / width), 0);
  gl_Position = vec4(point.xyz, 1.0);
  gl_PointSize = 1.0;
  level = point.w;
  index = gl_VertexID;
}
