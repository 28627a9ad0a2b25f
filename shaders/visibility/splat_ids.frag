// Which splat each sub-sample shows, of those that cover many cells. PS_KEYS: instead, the key of the surface that a splat
// shows which a compute shader has drawn.

#include "lib/visibility/splat.glsl"
#include "lib/visibility/surface_key.glsl"

void main()
{
#ifdef PS_KEYS
  uint id = texelFetch(ps_ids, ivec2(gl_FragCoord.xy), 0).x;
  int index = int(id & 0x7FFFFFFFu) - u.first_index;
  if ((id & PS_RASTERISED) != 0u || index < 0 || (index >> u.block_shift) >= u.block_count) {
    discard;
  }
#else
  int index = int(v_index);
#endif
  ivec3 element = ps_element(index);
  PsUnitSplat splat;
  bool drawn = ps_unit_splat(element, splat);
  PsSplatHit hit = ps_meet_splat(splat, gl_FragCoord.xy - splat.centre);
#ifndef PS_KEYS
  if (!drawn || !hit.there) {
    discard;
  }
  out_id = PS_RASTERISED | uint(u.first_index + index);
  out_depth = floatBitsToUint(max(hit.depth - u.near, 0.0));
  gl_FragDepth = ps_buffer_depth(hit.depth);
#endif
  vec3 toward = ps_view_from_pixel(ps_pixel_from_cell(gl_FragCoord.xy), 1.0);
  toward = ps_is_perspective() ? toward : vec3(0.0, 0.0, -1.0);
  int material = int(texelFetch(ps_extent, element.xy, 0).w);
  out_key = ps_surface_key(element.z, material, ps_splat_normal(splat, hit, toward));
}
