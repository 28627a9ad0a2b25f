// Splats in pages of 4,096-wide textures, and the blocks that a view draws. Layout: render/passes/image_space/projection.py.

#include "lib/geometry/instance.glsl"
#include "lib/data/pack.glsl"

// Which splat the drawn element `index` is: texel of its attributes, and its instance. x < 0: none. PS_DIRECT: a view draws all
// splats of a page, as one instance, and needs no blocks.
ivec3 ps_element(int index)
{
#ifdef PS_DIRECT
  return index < u.splats ? ivec3(ps_texel(index), u.only_instance) : ivec3(-1);
#else
  int block = index >> u.block_shift;
  if (block >= u.block_count) {
    return ivec3(-1);
  }
  vec4 record = texelFetch(ps_blocks, ps_texel(block), 0);
  int lane = index & ((1 << u.block_shift) - 1);
  if (lane >= int(record.z)) {
    return ivec3(-1);
  }
  int column = int(record.x) + lane;
  return ivec3(column & PS_PAGE_MASK, int(record.y) + (column >> PS_PAGE_SHIFT), int(record.w));
#endif
}
