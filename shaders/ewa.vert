// A square around each small splat's ellipse; PS_BLEND: around its kernel. Layout: render/passes/ewa.py.

#include "lib/ewa.glsl"
#include "lib/ewa_varyings.glsl"

void main()
{
  int index = frame.page.x + gl_VertexID;
  ivec2 at = ivec2(index & 4095, index >> 12);
  vec4 place = texelFetch(ps_splat_place, at, 0);
  gl_PointSize = 1.0;
  ps_no_splat();
  if (ps_kind(place) != 1) {
    return;
  }
  vec3 c = ps_splat(at, place);
#ifdef PS_BLEND
  float side = 2.0 * PS_EWA_CUTOFF_SIGMA * sqrt(max(c.x, c.z));
#else
  float side = 4.0 * sqrt(max(c.x, c.z));
#endif
  gl_PointSize = max(side, 1.0);
  gl_Position = vec4(v_place.xy / vec2(frame.size.xy) * 2.0 - 1.0, 0.0, 1.0);
}
