// Two triangles for each tile that `ps_tiles` names; the others vanish. No vertex attributes.

void main()
{
  int columns = textureSize(ps_tiles, 0).x;
  int index = gl_VertexID / 6;
  int corner = gl_VertexID - 6 * index;
  ivec2 tile = ivec2(index % columns, index / columns);
  bool wanted = texelFetch(ps_tiles, tile, 0).x != 0.0;
  vec2 beside = vec2(corner == 1 || corner == 2 || corner == 4 ? 1.0 : 0.0, corner == 2 || corner > 3 ? 1.0 : 0.0);
  vec2 position = min((vec2(tile) + beside) * u.tile_size, vec2(1.0)) * 2.0 - 1.0;
  gl_Position = vec4(wanted ? position : vec2(-2.0), 0.0, 1.0);
}
