// Ranks of cells among the sub-samples of their pixel, from 0 to PS_RANKS - 1: a multiple of the cell's number among the
// translations of the lattice of pixels. PS_RANK_COLUMN, PS_RANK_ROW: what ranks go on by from cell to cell, modulo PS_RANKS.

float ps_modulo(float number, float count)
{
  return number - count * floor((number + 0.5) / count);
}

#ifdef PS_LATTICE
float ps_cell_rank(ivec2 cell)
{
  // From the first pixel's central cell.
  vec2 at = vec2(cell) - floor(u.lattice.zw + 0.5 * vec2(u.lattice.x - u.lattice.y, u.lattice.x + u.lattice.y));
  return ps_modulo(float(PS_RANK_COLUMN) * at.x + float(PS_RANK_ROW) * at.y, float(PS_RANKS));
}
#endif
