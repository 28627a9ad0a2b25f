// Small triangles of one material of all instances of a mesh, or (PS_BLOCKS) of many meshes and materials, into the
// visibility buffer, one invocation each: the least depth of each sub-sample, then (PS_IDENTIFY) the lowest number among the
// triangles that have it, and the key of its surface.
// PS_LIST: instead, lists those that cover more cells than PS_MOST_CELLS, or cross the near plane, which the rasteriser draws;
// without it these are left out.
//
// A sub-sample on an edge belongs to both triangles. Each side of an edge is told by the same arithmetic, of its corners
// relative to the sub-sample, but for the sign: closed meshes have no holes.

#include "lib/data/index.glsl"
#include "lib/geometry/instance.glsl"
#include "lib/visibility/block.glsl"
#include "lib/data/pack.glsl"
#include "lib/visibility/lattice.glsl"
#include "lib/visibility/surface_key.glsl"

// Twice the area of the triangle of two corners and the origin.
float ps_edge(vec2 a, vec2 b)
{
  precise float area = a.x * b.y - a.y * b.x;
  return area;
}

void main()
{
  int index = ps_index();
  if (index >= u.elements) {
    return;
  }
#if defined(PS_BLOCKS)
  vec4 block = ps_block(index);
  int in_block = index & PS_BLOCK_MASK, slot = int(block.z), first = 3 * (int(block.x) + in_block);
  if (in_block >= int(block.y)) {
    return;
  }
#elif defined(PS_ONE_INSTANCE)
  int slot = 0, first = u.first + 3 * index;
#else
  int triangles = u.corners / 3, slot = u.first_slot + index / triangles, first = u.first + 3 * (index % triangles);
#endif
  vec4 corner0 = texelFetch(ps_corner, ps_texel(first), 0), corner1 = texelFetch(ps_corner, ps_texel(first + 1), 0);
  vec4 corner2 = texelFetch(ps_corner, ps_texel(first + 2), 0);
  vec3 p0 = ps_view_from_point(slot, corner0.xyz), p1 = ps_view_from_point(slot, corner1.xyz);
  vec3 p2 = ps_view_from_point(slot, corner2.xyz);
  vec3 d = -vec3(p0.z, p1.z, p2.z);
  float nearest = min(d.x, min(d.y, d.z)), farthest = max(d.x, max(d.y, d.z));
  if (farthest < u.near || nearest > u.far) {
    return;
  }
  bool crosses = nearest < max(u.near, 1e-30);
  vec2 a = ps_cell_from_pixel(ps_pixel_from_view(p0).xy), b = ps_cell_from_pixel(ps_pixel_from_view(p1).xy);
  vec2 c = ps_cell_from_pixel(ps_pixel_from_view(p2).xy);
  vec2 least = clamp(min(a, min(b, c)), vec2(-1.0), u.cells + 1.0), most = clamp(max(a, max(b, c)), vec2(-1.0), u.cells + 1.0);
  ivec2 low = max(ivec2(ceil(least - 0.5)), ivec2(0)), high = min(ivec2(floor(most - 0.5)), ivec2(u.cells) - 1);
  ivec2 span = high - low + 1;
  if (!crosses && (span.x <= 0 || span.y <= 0)) {
    return;
  }
  bool wide = crosses || span.x * span.y > PS_MOST_CELLS;
#ifdef PS_LIST
  if (wide) {
    // The length counts from -1, which EMPTY is.
    uint entry = imageAtomicAdd(list_length, ivec2(0), 1u) + 1u;
    if (entry < uint(u.list_size)) {
#ifdef PS_ONE_INSTANCE
      imageAtomicMin(list, ps_texel(int(entry)), uint(first / 3));
#else
      imageAtomicMin(list, ps_texel(int(entry)), uint(index));
#endif
    }
  }
#else
  bool front = ps_edge(b - a, c - a) > 0.0;
#if defined(PS_CULL) || defined(PS_IDENTIFY)
#ifdef PS_ONE_INSTANCE
  int instance = u.instance;
  bool mirrored = u.mirrored == 1;
#else
  int instance = int(ps_instance_row(slot, 3).y);
  bool mirrored = ps_instance_row(slot, 3).z > 0.5;
#endif
#endif
#ifdef PS_CULL
  wide = wide || front == mirrored;
#endif
  if (wide) {
    return;
  }
#ifdef PS_IDENTIFY
#ifdef PS_BLOCKS
  uint number = uint(u.first_id + index);
  int material = int(block.w);
#else
  uint number = uint(u.first_id) + uint(slot) * uint(u.triangles) + uint(first) / 3u;
  int material = u.material;
#endif
#ifdef PS_NORMAL
  mat3 linear = ps_linear(slot);
  vec3 n0 = ps_view_normal(linear, ps_unpack_normal(corner0.w)), n1 = ps_view_normal(linear, ps_unpack_normal(corner1.w));
  vec3 n2 = ps_view_normal(linear, ps_unpack_normal(corner2.w));
#endif
#endif
  vec3 scale = ps_is_perspective() ? 1.0 / d : vec3(1.0);
  float turned = front ? 1.0 : -1.0;
  for (int y = low.y; y <= high.y; y++) {
    for (int x = low.x; x <= high.x; x++) {
      vec2 centre = vec2(x, y) + 0.5;
      vec2 to_a = a - centre, to_b = b - centre, to_c = c - centre;
      precise vec3 sides = turned * vec3(ps_edge(to_b, to_c), ps_edge(to_c, to_a), ps_edge(to_a, to_b));
      precise vec3 weights = sides * scale;
      precise float sum = weights.x + weights.y + weights.z;
      precise float straight = (weights.x * d.x + weights.y * d.y + weights.z * d.z) / sum;
      float depth = clamp(straight, nearest, farthest);
      bool there = min(sides.x, min(sides.y, sides.z)) >= 0.0 && sum > 0.0 && depth <= u.far;
      if (there) {
        uint key = floatBitsToUint(max(depth - u.near, 0.0));
#ifdef PS_IDENTIFY
        if (texelFetch(ps_depths, ivec2(x, y), 0).x == key) {
          // Of several at one depth any may write its key: they then lie upon each other.
          if (imageAtomicMin(ids, ivec2(x, y), number) > number) {
            vec3 normal = vec3(0.0, 0.0, 1.0);
#ifdef PS_NORMAL
            // Of the sub-sample: leaves of a few pixels may be bent by more than what one group's normals differ.
            normal = turned / sum * (weights.x * n0 + weights.y * n1 + weights.z * n2);
#endif
            imageStore(keys, ivec2(x, y), uvec4(ps_surface_key(instance, material, normal)));
          }
        }
#else
        imageAtomicMin(depths, ivec2(x, y), key);
#endif
      }
    }
  }
#endif
}
