// The finished picture and its depth into the viewport, so that Blender's overlays hide behind points. PS_SURFACES: there
// are any.

#include "lib/geometry/surfel_kind.glsl"

void main()
{
  ivec2 pixel = ivec2(v_uv * vec2(u.size));
  pixel = clamp(pixel, ivec2(0), u.size - 1) + u.corner;
  float weight = u.sample_weight;
#ifdef PS_TILE
  float count = texelFetch(ps_counts, pixel / PS_TILE, 0).x;
  weight = count > 0.0 ? 1.0 / count : weight;
#endif
  out_color = texelFetch(ps_combined, pixel, 0) * weight;
  gl_FragDepth = 1.0;
#ifdef PS_SURFACES
  vec4 centre = texelFetch(ps_centre, pixel, 0);
  float d = centre.x;
  bool there = ps_is_there(centre);
  vec4 z = u.clip_from_depth;  // clip z = z.x * view z + z.y, clip w = z.z * view z + z.w
  gl_FragDepth = there ? clamp(0.5 * (z.x * -d + z.y) / (z.z * -d + z.w) + 0.5, 0.0, 1.0) : 1.0;
#endif
}
