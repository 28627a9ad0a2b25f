// Which segment each sub-sample shows. A strip that is wider than its strand covers a share of its cells: those whose rank, a
// multiple of the golden ratio for each column or row and another beginning for each strand, is below the share.
// PS_DEPTH_ONLY: only how far away it is.

#include "lib/strands/segment.glsl"
#include "lib/visibility/lattice.glsl"
#include "lib/visibility/surface_key.glsl"

#define PS_HALF_CELL 0.501  // and what is lost by rounding
#define PS_GOLDEN 2654435769u  // 2^32 times the golden ratio

void main()
{
#ifdef PS_TUBE
  PsTube tube = PsTube(v_from, v_to, v_begin, v_end);
  PsHit hit = ps_meet_tube(ps_pixel_from_cell(gl_FragCoord.xy), tube);
  float d = hit.d;
#ifdef PS_DEPTH_ONLY
  // Where the ray leaves it: a strand that is shaded as a whole does not shade itself. Half of the way there is where ray and axis
  // are nearest to each other.
  vec3 p = ps_view_from_pixel(ps_pixel_from_cell(gl_FragCoord.xy), d), ray = ps_is_perspective() ? p / d : vec3(0.0, 0.0, -1.0);
  vec3 axis = v_to.xyz - v_from.xyz, apart = p - v_from.xyz;
  axis *= 1.0 / max(length(axis), 1e-30);
  float far = dot(ray, ray), across = dot(ray, axis);
  float nearest = (across * dot(axis, apart) - dot(ray, apart)) / max(far - across * across, PS_LEAST_SINE * PS_LEAST_SINE * far);
  d += 2.0 * max(nearest, 0.0);
#endif
  if (!(d >= u.near && d <= u.far)) {
    discard;
  }
#ifndef PS_DEPTH_ONLY
  PsSegment segment = PsSegment(ps_texel(int(v_segment.x)), ps_texel(int(v_segment.y)), int(v_segment.z), v_segment.w,
                                vec4(0.0));
#ifdef PS_NORMAL
  vec4 normal = ps_tube_normal(segment, tube, hit);
  out_key = ps_surface_key(segment.instance, int(segment.material), normal.xyz) | (normal.w > 0.5 ? PS_FIBRE_KEY : 0u);
#else
  out_key = ps_surface_key(segment.instance, int(segment.material), vec3(0.0, 0.0, 1.0));
#endif
#endif
#else
  ivec2 cell = ivec2(gl_FragCoord.xy) + u.cell_offset;
#ifdef PS_THIN
  // Some rasterisers draw lines as rectangles, which have two cells in some columns.
  vec2 at = v_rows == 1 ? gl_FragCoord.yx : gl_FragCoord.xy;
  if (abs(at.y - v_line.y - v_line.z * (at.x - v_line.x)) > PS_HALF_CELL) {
    discard;
  }
#endif
  uint rank = uint(v_rows == 1 ? cell.y : cell.x) * PS_GOLDEN + v_phase;
  if (float(rank >> 8u) >= 16777216.0 * abs(v_extent.x / v_extent.y)) {
    discard;
  }
  float d = -v_position.z;
#ifndef PS_DEPTH_ONLY
  out_key = v_key;
#endif
#endif
#ifndef PS_DEPTH_ONLY
  out_id = v_id;
#endif
  out_depth = floatBitsToUint(max(d - u.near, 0.0));
  gl_FragDepth = ps_buffer_depth(d);
}
