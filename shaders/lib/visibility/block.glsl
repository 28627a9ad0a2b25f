// Triangles of pages of many meshes, in blocks of up to PS_BLOCK, each of one mesh, one instance and one material. `ps_blocks`
// has for each: first triangle on the page, number of triangles, slot of the instance, row of the material. Layout:
// render/passes/visibility/polygon_draw.py.

#include "lib/geometry/instance.glsl"

#define PS_BLOCK_MASK ((1 << PS_BLOCK_SHIFT) - 1)

#ifdef PS_BLOCKS
// Of the triangle of this number in a draw whose first block is u.first.
vec4 ps_block(int number)
{
  return texelFetch(ps_blocks, ps_texel(u.first + (number >> PS_BLOCK_SHIFT)), 0);
}
#endif
