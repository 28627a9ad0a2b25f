// Triangles of one material of all instances of a mesh, corner by corner from textures, into the cells of sub-samples.
// PS_BLOCKS: those of many meshes and materials. PS_DEPTH_ONLY: which triangle it is does not matter. PS_LISTED: only those that
// a list names, counted through the instances.

#include "lib/geometry/instance.glsl"
#include "lib/data/pack.glsl"
#include "lib/data/patch.glsl"
#include "lib/visibility/block.glsl"
#include "lib/visibility/lattice.glsl"
#ifdef PS_CUT
#include "lib/visibility/cut.glsl"
#endif

void main()
{
#ifdef PS_LISTED
  int number = 3 * int(texelFetch(ps_list, ps_texel(gl_VertexID / 3), 0).x) + gl_VertexID % 3;
#else
  int number = gl_VertexID;
#endif
#if defined(PS_BLOCKS)
  int triangle = number / 3, in_block = triangle & PS_BLOCK_MASK;
  vec4 block = ps_block(triangle);
  // Those that a block lacks have one corner, thrice.
  bool there = in_block < int(block.y);
  int slot = int(block.z), corner_index = 3 * (int(block.x) + (there ? in_block : 0)) + (there ? number - 3 * triangle : 0);
#elif defined(PS_ONE_INSTANCE)
  int slot = 0, corner_index = u.first + number;
#else
  int slot = u.first_slot + number / u.corners, corner_index = u.first + number % u.corners;
#endif
  ivec2 texel = ps_texel(corner_index);
  vec4 corner = texelFetch(ps_corner, texel, 0);
  v_position = ps_view_from_point(slot, corner.xyz);
#ifdef PS_NORMAL
  v_normal = ps_view_normal(ps_linear(slot), ps_unpack_normal(corner.w));
#endif
#ifdef PS_UV
  v_uv = texelFetch(ps_corner_uv, texel, 0).xy;
#endif
#ifdef PS_LEVELS
  int first_corner = corner_index / 3 * 3;
  vec2 uv_first = texelFetch(ps_corner_uv, ps_texel(first_corner), 0).xy;
  v_patch = ps_patch_area(texelFetch(ps_corner_uv, ps_texel(first_corner + 1), 0).xy - uv_first,
                          texelFetch(ps_corner_uv, ps_texel(first_corner + 2), 0).xy - uv_first);
#endif
#ifdef PS_CORNER_COLOR
  v_color = texelFetch(ps_corner_color, texel, 0);
#endif
#if defined(PS_CUT) || !(defined(PS_DEPTH_ONLY) || defined(PS_WITHOUT_KEYS))
#ifdef PS_ONE_INSTANCE
  int instance = u.instance;
#else
  int instance = int(ps_instance_row(slot, 3).y);
#endif
#endif
#ifdef PS_CUT
#ifdef PS_BLOCKS
  v_cut = ps_cut_of(corner_index / 3 - int(ps_instance_row(slot, 3).w), instance);
#else
  v_cut = ps_cut_of(corner_index / 3, instance);
#endif
#endif
#ifndef PS_DEPTH_ONLY
#if defined(PS_BLOCKS)
  v_id = uint(u.first_id + triangle);
  v_about = vec3(instance, ps_instance_row(slot, 3).z, block.w);
#else
  v_id = uint(u.first_id) + uint(slot) * uint(u.triangles) + uint(corner_index) / 3u;
#ifdef PS_WITHOUT_KEYS
#elif defined(PS_ONE_INSTANCE)
  v_about = vec2(instance, u.mirrored);
#else
  v_about = vec2(instance, ps_instance_row(slot, 3).z);
#endif
#endif
#endif
  gl_Position = ps_cell_clip(ps_clip_from_view(v_position));
}
