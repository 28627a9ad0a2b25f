// Segments of strands from pages of control points. Layout: render/passes/visibility/strands.py.
// PS_THIN: raster lines, one pixel wide. PS_TUBE: rectangles around the pictures of what two balls and all between them
// fill. Else two triangles each: PS_RIBBON, or strips that face the eye in place of tubes that are too narrow to be seen
// round.

#include "lib/geometry/instance.glsl"

#if defined(PS_TUBE)
// Pixels around the picture of a ball's middle (perspective: the middle no nearer than the near plane) that hold what
// lies before the eye.
float ps_ball_reach(vec4 ball)
{
  float focal = max(abs(u.focal.x), abs(u.focal.y));
  if (!ps_is_perspective()) {
    return focal * ball.w;
  }
  float middle = max(-ball.z, u.near), nearest = max(-ball.z - ball.w, u.near);
  return focal * (ball.w / nearest + length(ball.xy) * max(1.0 / nearest - 1.0 / middle, 0.0));
}

// Where the part of the axis ends, from a towards b, that has balls before the near plane.
vec4 ps_before_eye(vec4 a, vec4 b)
{
  float from = -a.z + a.w - u.near, to = -b.z + b.w - u.near;
  return from < 0.0 && to > 0.0 ? mix(a, b, from / (from - to)) : a;
}
#endif

#ifdef PS_TUBE
// The plane in which a strand ends: what is kept has dot(plane.xyz, p) + plane.w >= 0.
vec4 ps_end_plane(int instance, float point, float sense)
{
  if (point < 0.0) {
    return vec4(0.0, 0.0, 0.0, 1.0);
  }
  ivec2 at = ps_texel(int(point));
  vec3 inward = sense * normalize(ps_linear(instance) * texelFetch(ps_tangent, at, 0).xyz);
  return vec4(inward, -dot(inward, ps_view_from_point(instance, texelFetch(ps_point, at, 0).xyz)));
}
#endif

void main()
{
#ifdef PS_THIN
  int index = gl_VertexID >> 1, corner = gl_VertexID & 1;
#else
  int index = gl_VertexID / 6, corner = gl_VertexID - 6 * index;
#endif
  ivec2 at = ivec2(texelFetch(ps_list, ps_texel(u.first + index), 0).xy);
  vec4 segment = texelFetch(ps_segments, at, 0);
  int instance = int(segment.z);
  ivec2 texel[2] = ivec2[2](ps_texel(int(segment.x)), ps_texel(int(segment.y)));
  v_segment = segment;

#ifdef PS_TUBE
  float scale = ps_instance_row(instance, 3).y;
  vec4 from = texelFetch(ps_point, texel[0], 0), to = texelFetch(ps_point, texel[1], 0);
  vec4 a = vec4(ps_view_from_point(instance, from.xyz), scale * from.w);
  vec4 b = vec4(ps_view_from_point(instance, to.xyz), scale * to.w);
  v_from = a;
  v_to = b;
  vec4 ends = texelFetch(ps_segments, at + ivec2(1, 0), 0);
  v_begin = ps_end_plane(instance, ends.x, 1.0);
  v_end = ps_end_plane(instance, ends.y, -1.0);
  vec4 near_a = ps_is_perspective() ? ps_before_eye(a, b) : a, near_b = ps_is_perspective() ? ps_before_eye(b, a) : b;
  // What balls at the near plane are cut to may reach farther than at either end.
  bool cut = ps_is_perspective() && min(-a.z - a.w, -b.z - b.w) < u.near;
  float around = max(ps_ball_reach(near_a), ps_ball_reach(near_b)) * (cut ? 1.5 : 1.0) + 0.01;
  float low = u.near;
  vec2 p = ps_pixel_from_view(vec3(near_a.xy, ps_is_perspective() ? min(near_a.z, -low) : near_a.z)).xy;
  vec2 q = ps_pixel_from_view(vec3(near_b.xy, ps_is_perspective() ? min(near_b.z, -low) : near_b.z)).xy;
  vec2 size = vec2(u.size), along = q - p;
  float len = length(along);
  along = len > 1e-6 ? along / len : vec2(1.0, 0.0);
  vec2 across = vec2(-along.y, along.x);
  vec2 side = vec2(corner == 1 || corner == 2 || corner == 4 ? 1.0 : -1.0,
                   corner == 2 || corner == 4 || corner == 5 ? 1.0 : -1.0);
  vec2 pixel = (side.x > 0.0 ? q : p) + around * (side.x * along + side.y * across);
  // What reaches far beyond the picture is cut to it first: rasterisers have only so many digits.
  vec2 least = min(p, q) - around, most = max(p, q) + around;
  if (around + len > 2.0 * max(size.x, size.y)) {
    pixel = clamp(mix(least, most, 0.5 * side + 0.5), vec2(-1.0), size + 1.0);
  }
  bool nothing = any(greaterThan(least, size)) || any(lessThan(most, vec2(0.0))) || !(around < 1e30) ||
                 (ps_is_perspective() && max(-a.z + a.w, -b.z + b.w) <= u.near);
  gl_Position = nothing ? vec4(2.0, 2.0, 2.0, 1.0) : vec4(pixel / size * 2.0 - 1.0, 0.0, 1.0);
#else
#ifdef PS_THIN
  int end = corner;
#else
  int end = corner == 1 || corner == 2 || corner == 4 ? 1 : 0;
#endif
  v_along = float(end);
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
    vec4 share = texelFetch(ps_segments, at + ivec2(1, 0), 0);
    vec2 chord = abs(ps_pixel_from_view(p[1]).xy - ps_pixel_from_view(p[0]).xy);
    float line = max(chord.x, chord.y) / max(length(chord), 1e-6);
    for (int i = 0; i < 2; i++) {
      float width = 2.0 * radius[i] * sqrt(abs(u.focal.x * u.focal.y)) / (ps_is_perspective() ? -p[i].z : 1.0);
      float wanted = (i == 0 ? share.x : share.y) * line;
      sides[i] *= width > 1e-6 ? clamp(wanted / width, 0.5, 2.0) : 1.0;
    }
  }
#endif
  float right = corner == 2 || corner == 4 || corner == 5 ? 1.0 : -1.0;
  v_position = p[end] + right * sides[end];
  // Where a ribbon turns its other side to the eye, its edges cross: there are two triangles with one tip in common, for
  // two that make a quad would hide that it is edge on between them. Sides are seen with the axis: their sense is that of
  // the plane through the eye and the axis.
  vec3 plane = cross(p[1] - p[0], ps_is_perspective() ? p[0] : vec3(0.0, 0.0, -1.0));
  float seen = dot(sides[0], plane), other = dot(sides[1], plane);
  if (sign(seen) * sign(other) < 0.0) {
    v_along = corner == 2 || corner == 4 ? seen / (seen - other) : v_along;
    if (corner == 2 || corner == 4) {
      v_position = mix(p[0], p[1], v_along);
    } else if (corner < 3) {
      v_along = 0.0;
      v_position = p[0] + (corner == 0 ? -1.0 : 1.0) * sides[0];
    } else {
      v_along = 1.0;
      v_position = p[1] + (corner == 3 ? -1.0 : 1.0) * sides[1];
    }
  }
#else
  vec4 point = texelFetch(ps_point, texel[end], 0);
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
  vec4 share = texelFetch(ps_segments, at + ivec2(1, 0), 0);
  v_share = vec2(end == 0 ? share.x : share.y, share.z);
#endif
  gl_Position = ps_clip_from_view(v_position);
#endif
}
