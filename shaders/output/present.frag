// The finished picture and its depth into the viewport, so that Blender's overlays hide behind points. PS_SURFACES: there
// are any.
// PS_SMOOTH: its pixels are wider than the viewport's, and colours change evenly from centre to centre.

#include "lib/geometry/surfel_kind.glsl"

// The mean of a pixel's samples.
vec4 mean_of(ivec2 pixel)
{
  pixel = clamp(pixel, ivec2(0), u.size - 1) + u.corner;
  float weight = u.sample_weight;
#ifdef PS_TILE
  float count = texelFetch(ps_counts, pixel / PS_TILE, 0).x;
  weight = count > 0.0 ? 1.0 / count : weight;
#endif
  return texelFetch(ps_combined, pixel, 0) * weight;
}

void main()
{
  ivec2 pixel = ivec2(v_uv * vec2(u.size));
#ifdef PS_SMOOTH
  vec2 at = v_uv * vec2(u.size) - 0.5;
  ivec2 low = ivec2(floor(at));
  vec2 part = at - vec2(low);
  vec4 lower = mix(mean_of(low), mean_of(low + ivec2(1, 0)), part.x);
  vec4 upper = mix(mean_of(low + ivec2(0, 1)), mean_of(low + ivec2(1, 1)), part.x);
  out_color = mix(lower, upper, part.y);
#else
  out_color = mean_of(pixel);
#endif
  gl_FragDepth = 1.0;
#ifdef PS_SURFACES
  pixel = clamp(pixel, ivec2(0), u.size - 1) + u.corner;
  vec4 centre = texelFetch(ps_centre, pixel, 0);
  float d = centre.x;
  bool there = ps_is_there(centre);
  vec4 z = u.clip_from_depth;  // clip z = z.x * view z + z.y, clip w = z.z * view z + z.w
  gl_FragDepth = there ? clamp(0.5 * (z.x * -d + z.y) / (z.z * -d + z.w) + 0.5, 0.0, 1.0) : 1.0;
#endif
}
