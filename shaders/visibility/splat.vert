// Splats that cover many cells: a rectangle around each one's picture. PS_LISTED: those that a list names; else all, one by
// one.

#include "lib/visibility/splat.glsl"

void main()
{
  int entry = gl_VertexID / 6, corner = gl_VertexID - 6 * entry;
#ifdef PS_LISTED
  int index = int(texelFetch(ps_list, ps_texel(entry), 0).x);
#else
  int index = entry;
#endif
  v_index = uint(index);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  ivec3 element = ps_element(index);
  PsUnitSplat splat;
  if (element.x < 0 || !ps_unit_splat(element, splat)) {
    return;
  }
#ifdef PS_CULL
  if (ps_is_culled(element)) {
    return;
  }
#endif
  ivec2 side = ivec2(corner == 1 || corner == 2 || corner == 4, corner == 2 || corner == 4 || corner == 5);
  vec2 cell = clamp(vec2(side.x == 0 ? splat.box.x : splat.box.z, side.y == 0 ? splat.box.y : splat.box.w),
                    vec2(-1.0), u.cells + 1.0);
  gl_Position = vec4(cell / u.cells * 2.0 - 1.0, 0.0, 1.0);
}
