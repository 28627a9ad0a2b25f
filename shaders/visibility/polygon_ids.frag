// Which triangle each sub-sample shows. PS_DEPTH_ONLY: only how far away it is.

#include "lib/geometry/camera.glsl"
#include "lib/data/polygon.glsl"
#include "lib/visibility/surface_key.glsl"

void main()
{
  if (ps_see_through()) {
    discard;
  }
#ifdef PS_CULL
  if (gl_FrontFacing == (v_about.y > 0.5)) {
    discard;
  }
#endif
  float d = -v_position.z;
  out_depth = floatBitsToUint(max(d - u.near, 0.0));
#ifndef PS_DEPTH_ONLY
  vec3 normal = vec3(0.0, 0.0, 1.0);
#ifdef PS_NORMAL
  normal = gl_FrontFacing ? v_normal : -v_normal;  // as the triangle is shaded
#endif
  out_id = PS_RASTERISED | v_id;
  out_key = ps_surface_key(int(v_about.x), u.material, normal);
#endif
  gl_FragDepth = ps_buffer_depth(d);
}
