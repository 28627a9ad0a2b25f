// Segments of strands into the cells of sub-samples. PS_TUBE: rectangles around what two balls and all between them fill.
// PS_THIN: raster lines. Else two triangles each: PS_RIBBON, or strips that face the eye in place of tubes that are too narrow
// to be seen round. PS_DEPTH_ONLY: which segment it is does not matter.

#include "lib/strands/segment.glsl"
#include "lib/strands/covered_strip.glsl"
#include "lib/strands/tube_bounds.glsl"
#include "lib/visibility/surface_key.glsl"

#ifndef PS_TUBE
// The direction that tells a strip's surface from others.
vec3 ps_strip_direction(PsSegment segment)
{
  vec3 found = vec3(0.0, 0.0, 1.0);
#ifdef PS_NORMAL
  mat3 linear = ps_linear(segment.instance);
  found = linear * (texelFetch(ps_tangent, segment.from, 0).xyz + texelFetch(ps_tangent, segment.to, 0).xyz);
#ifdef PS_RIBBON
  found = cross(found, linear * (texelFetch(ps_side, segment.from, 0).xyz + texelFetch(ps_side, segment.to, 0).xyz));
#endif
#endif
  return ps_direction(found, vec3(0.0, 0.0, 1.0));
}

// Spreads numbers with an order over all of 32 bits (O'Neill 2014).
uint ps_hash(uint number)
{
  uint state = number * 747796405u + 2891336453u;
  uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
  return (word >> 22u) ^ word;
}
#endif

void main()
{
#ifdef PS_THIN
  int entry = u.first + gl_VertexID / 2, corner = gl_VertexID % 2;
#else
  int entry = u.first + gl_VertexID / 6, corner = gl_VertexID % 6;
#endif
  ivec2 at = ivec2(texelFetch(ps_segment_list, ps_texel(entry), 0).xy);
  PsSegment segment = ps_segment(at);
#ifndef PS_DEPTH_ONLY
  v_id = PS_RASTERISED | uint(u.first_id + entry);
#endif
#ifdef PS_TUBE
  PsTube tube = ps_tube(segment);
  v_from = tube.from;
  v_to = tube.to;
  v_begin = tube.begin;
  v_end = tube.end;
  gl_Position = ps_cell_clip(ps_tube_corner(tube, corner));
#ifndef PS_DEPTH_ONLY
  v_segment = texelFetch(ps_segments, at, 0);
#endif
#else
#ifndef PS_DEPTH_ONLY
  v_key = ps_surface_key(segment.instance, int(segment.material), ps_strip_direction(segment));
#if defined(PS_NORMAL) && !defined(PS_RIBBON)
  v_key |= PS_FIBRE_KEY;
#endif
#endif
  v_phase = ps_hash(floatBitsToUint(segment.rest.z)) + u.turn;
#ifdef PS_THIN
  bool there = true;
  PsCovered found = ps_covered(segment, corner);
#else
  PsStrip strip;
  bool there = ps_strip(segment, strip);
  PsCovered found = ps_covered(segment, strip, corner);
#endif
  v_position = found.position;
#if defined(PS_DEPTH_ONLY) && !defined(PS_RIBBON)
  // The side that light leaves, as deep as a ray goes through the strand: a strand that is shaded as a whole does not shade itself.
#ifdef PS_THIN
  bool second = corner == 1;
#else
  bool second = corner == 1 || corner == 2 || corner == 4;
#endif
  vec4 from = texelFetch(ps_point, segment.from, 0), to = texelFetch(ps_point, segment.to, 0);
  vec3 along = ps_linear(segment.instance) * (to.xyz - from.xyz);
  vec3 ray = ps_is_perspective() ? normalize(v_position) : vec3(0.0, 0.0, -1.0);
  float sine = length(cross(along, ray)) / max(length(along), 1e-30);
  v_position.z -= ps_instance_row(segment.instance, 3).y * (second ? to.w : from.w) / max(sine, PS_LEAST_SINE);
#endif
  v_extent = found.extent;
  v_rows = found.rows ? 1 : 0;
#ifdef PS_THIN
  v_line = found.line;
#endif
  gl_Position = there ? found.clip : vec4(2.0, 2.0, 2.0, 1.0);
#endif
}
