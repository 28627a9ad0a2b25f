// Which splat each sub-sample shows, of those that cover many cells. PS_DEPTH_ONLY: only how far away it is.

#include "lib/visibility/splat.glsl"
#include "lib/visibility/surface_key.glsl"

void main()
{
  int index = int(v_index);
  ivec3 element = ps_element(index);
  PsUnitSplat splat;
  bool drawn = ps_unit_splat(element, splat);
  PsSplatHit hit = ps_meet_splat(splat, gl_FragCoord.xy - splat.centre);
  if (!drawn || !hit.there) {
    discard;
  }
#if defined(PS_NODES) || defined(PS_PARTLY)
  if (!ps_is_covered(splat.covered, hit.share, ivec2(gl_FragCoord.xy))) {
    discard;
  }
#endif
  out_depth = floatBitsToUint(max(hit.depth - u.near, 0.0));
  gl_FragDepth = ps_buffer_depth(hit.depth);
#ifndef PS_DEPTH_ONLY
  out_id = PS_RASTERISED | uint(u.first_index + index);
  vec3 toward = ps_view_from_pixel(ps_pixel_from_cell(gl_FragCoord.xy), 1.0);
  toward = ps_is_perspective() ? toward : vec3(0.0, 0.0, -1.0);
  int material = int(ps_splat_extent(element).w);
  out_key = ps_surface_key(element.z, material, ps_splat_normal(splat, hit, toward));
#endif
}
