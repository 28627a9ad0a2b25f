// Which triangle each sub-sample shows. PS_DEPTH_ONLY: only how far away it is. PS_CUT: its alpha is not always 1.
// PS_PEELED: what does not lie before the least depth of a layer, whose bits ps_following inverts. PS_BEFORE_OPAQUE:
// what lies before what is opaque. PS_WITHOUT_KEYS: surfaces are not told apart.

#include "lib/geometry/camera.glsl"
#include "lib/data/polygon.glsl"
#include "lib/visibility/lattice.glsl"
#include "lib/visibility/surface_key.glsl"
#ifdef PS_CUT
#include "lib/visibility/cut.glsl"
#endif

#define PS_OF_CELL 0.5  // of a cell's side: shares of cells are covered at random, and edges in their centres are not

void main()
{
#ifdef PS_CUT
#ifdef PS_LEVELS
  float alpha = ps_cell_alpha(ps_baked_color, ps_baked_color_levels, v_uv, v_patch, PS_OF_CELL * u.footprint);
#else
  float alpha = ps_polygon_alpha();
#endif
  if (ps_is_cut_out(alpha, v_cut, ps_cell_rank(ivec2(gl_FragCoord.xy)), ps_pixel_from_cell(gl_FragCoord.xy))) {
    discard;
  }
#endif
#ifdef PS_CULL
  if (gl_FrontFacing == (v_about.y > 0.5)) {
    discard;
  }
#endif
  float d = -v_position.z;
  out_depth = floatBitsToUint(max(d - u.near, 0.0));
#ifdef PS_PEELED
  if (out_depth < ~texelFetch(ps_following, ivec2(gl_FragCoord.xy), 0).x) {
    discard;
  }
#endif
#ifdef PS_BEFORE_OPAQUE
  if (out_depth >= texelFetch(ps_opaque_depths, ivec2(gl_FragCoord.xy), 0).x) {
    discard;
  }
#endif
#ifndef PS_DEPTH_ONLY
  out_id = PS_RASTERISED | v_id;
#ifndef PS_WITHOUT_KEYS
  vec3 normal = vec3(0.0, 0.0, 1.0);
#ifdef PS_NORMAL
  normal = gl_FrontFacing ? v_normal : -v_normal;  // as the triangle is shaded
#endif
#ifdef PS_BLOCKS
  int material = int(v_about.z);
#else
  int material = u.material;
#endif
  out_key = ps_surface_key(int(v_about.x), material, normal);
#endif
#endif
  gl_FragDepth = ps_buffer_depth(d);
}
