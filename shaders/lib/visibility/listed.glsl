// The list of all groups of sub-samples, one texel a group: the number of its pixel, counted row by row, and its layer among the
// pixel's groups. PS_CENTRAL: instead, each texel stands for what lies under the centre of the pixel at its place; u.corner is where in the picture the tile begins.

struct PsListed {
  ivec2 pixel;
  int layer;  // -1: no group is there
};

PsListed ps_listed(ivec2 texel)
{
#ifdef PS_CENTRAL
  return PsListed(texel - u.corner, 0);
#else
  vec2 entry = texelFetch(ps_list, texel, 0).xy;
  // Software renderers divide integers one by one; the quotient of floats is off by one at most.
  float width = float(u.size.x), row = floor(entry.x / width), column = entry.x - row * width;
  row += column < 0.0 ? -1.0 : (column < width ? 0.0 : 1.0);
  return PsListed(ivec2(entry.x - row * width, row), int(entry.y));
#endif
}
