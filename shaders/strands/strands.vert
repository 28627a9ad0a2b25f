// Segments of strands from pages of control points. Layout: render/passes/strands/strand_page.py.
// PS_THIN: raster lines, one pixel wide. PS_TUBE: rectangles around the pictures of what two balls and all between them
// fill. Else two triangles each: PS_RIBBON, or strips that face the eye in place of tubes that are too narrow to be seen
// round.

#include "lib/strands/segment.glsl"
#include "lib/strands/strip.glsl"
#include "lib/strands/tube_bounds.glsl"

void main()
{
#ifdef PS_THIN
  int index = gl_VertexID >> 1, corner = gl_VertexID & 1;
#else
  int index = gl_VertexID / 6, corner = gl_VertexID - 6 * index;
#endif
  ivec2 at = ivec2(texelFetch(ps_segment_list, ps_texel(u.first + index), 0).xy);
  v_segment = texelFetch(ps_segments, at, 0);
  PsSegment segment = ps_segment(at);
  int instance = segment.instance;

#ifdef PS_TUBE
  PsTube tube = ps_tube(segment);
  v_from = tube.from;
  v_to = tube.to;
  v_begin = tube.begin;
  v_end = tube.end;
  gl_Position = ps_tube_corner(tube, corner);
#else
  ivec2 texel[2] = ivec2[2](segment.from, segment.to);
#ifndef PS_THIN
  mat3 linear = ps_linear(instance);
  vec3 p[2], sides[2];
  float radius[2];
  for (int i = 0; i < 2; i++) {
    vec4 point = texelFetch(ps_point, texel[i], 0);
    p[i] = ps_view_from_point(instance, point.xyz);
#ifdef PS_RIBBON
    sides[i] = linear * texelFetch(ps_side, texel[i], 0).xyz * point.w;
#else
    vec3 toward = ps_is_perspective() ? p[i] : vec3(0.0, 0.0, -1.0);
    sides[i] = cross(linear * texelFetch(ps_tangent, texel[i], 0).xyz, toward);
    radius[i] = ps_instance_row(instance, 3).y * point.w;
    sides[i] *= radius[i] / max(length(sides[i]), 1e-30);
#endif
  }
#ifndef PS_RIBBON
  // A segment that stands for several has their area: their share of the raster's line, which is what they are drawn
  // with where they are thinner. Where it hardly has a length that may be any width.
  float near = ps_is_perspective() ? u.near : -1e30;
  if (-p[0].z > near && -p[1].z > near) {
    vec2 chord = abs(ps_pixel_from_view(p[1]).xy - ps_pixel_from_view(p[0]).xy);
    float line = max(chord.x, chord.y) / max(length(chord), 1e-6);
    for (int i = 0; i < 2; i++) {
      float width = 2.0 * radius[i] * sqrt(abs(u.focal.x * u.focal.y)) / (ps_is_perspective() ? -p[i].z : 1.0);
      float wanted = (i == 0 ? segment.rest.x : segment.rest.y) * line;
      sides[i] *= width > 1e-6 ? clamp(wanted / width, 0.5, 2.0) : 1.0;
    }
  }
#endif
  v_position = ps_strip_corner(corner, p, sides, v_along);
#else
  v_along = float(corner);
  vec4 point = texelFetch(ps_point, texel[corner], 0);
  v_position = ps_view_from_point(instance, point.xyz);
#endif
#ifdef PS_NORMAL
  vec3 tangent = mix(texelFetch(ps_tangent, texel[0], 0).xyz, texelFetch(ps_tangent, texel[1], 0).xyz, v_along);
#ifdef PS_THIN
  mat3 linear = ps_linear(instance);
#endif
  v_normal = linear * tangent;
#ifdef PS_RIBBON
  // Normal and tangent make the plane of a ribbon; the matrix turns both, so that sheared ones stay in theirs.
  vec3 side = mix(texelFetch(ps_side, texel[0], 0).xyz, texelFetch(ps_side, texel[1], 0).xyz, v_along);
  v_normal = cross(v_normal, linear * side);
#endif
  v_normal = ps_direction(v_normal, vec3(0.0));
#endif
#ifdef PS_THIN
  v_share = vec2(corner == 0 ? segment.rest.x : segment.rest.y, segment.rest.z);
#endif
  gl_Position = ps_clip_from_view(v_position);
#endif
}
