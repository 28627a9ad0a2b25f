// Which splat: see project.vert.
#ifdef PS_DISCONNECTED
#include "lib/geometry/footprint.glsl"
#endif

void main()
{
#ifdef PS_DISCONNECTED
  if (ps_ellipse.x > 0.0 && ps_off_centre(ps_ellipse, ps_centre - gl_FragCoord.xy) != 0u) {
    discard;
  }
#endif
  id = ps_id;
  gl_FragDepth = ps_order;
}
