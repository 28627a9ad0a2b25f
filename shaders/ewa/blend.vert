// A square around each small splat's ellipse; PS_BLEND: around its kernel. Layout: render/passes/ewa/ewa.py.

#include "lib/splat/ewa.glsl"
#include "lib/splat/ewa_varyings.glsl"

#ifdef PS_BLEND
// Whether the middle and the four corners of a square with the given half side lie behind what was seen there. What shows
// of a splat between them at most is narrower than half the square, and belongs to splats that have their middle there.
bool ps_hidden(vec4 centre, float side)
{
  ivec2 last = textureSize(ps_nearest, 0) - 1;
  float front = centre.z - v_front.w - side * (abs(v_front.x) + abs(v_front.y));
  for (int i = 0; i < 5; i++) {
    vec2 corner = i == 4 ? vec2(0.0) : vec2(i & 1, i >> 1) * 2.0 - 1.0;
    vec2 seen = texelFetch(ps_nearest, clamp(ivec2(floor(v_centre.xy + side * corner)), ivec2(0), last), 0).xy;
    if (seen.x == 0.0 || front <= seen.y) {
      return false;
    }
  }
  return true;
}
#endif

void main()
{
  ivec2 at = ps_listed(u.first + gl_VertexID);
  vec4 centre = texelFetch(ps_splat_centre, at, 0);
  gl_PointSize = 1.0;
  vec3 c = ps_splat(at, centre);
#ifdef PS_BLEND
  float side = PS_EWA_CUTOFF_SIGMA * sqrt(max(c.x, c.z));
  if (ps_hidden(centre, side)) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    return;
  }
#else
  float side = sqrt(v_conic.w * max(c.x, c.z));
#endif
  gl_PointSize = max(2.0 * side, 1.0);
  gl_Position = vec4(v_centre.xy / vec2(u.size) * 2.0 - 1.0, 0.0, 1.0);
}
