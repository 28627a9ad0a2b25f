// Rectangles around the pictures of tubes.

#include "lib/geometry/camera.glsl"
#include "lib/strands/tube.glsl"

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

// In clip space, one of the six corners of two triangles that hold a tube's picture; outside of it where there is none.
vec4 ps_tube_corner(PsTube tube, int corner)
{
  vec4 a = tube.from, b = tube.to;
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
  return nothing ? vec4(2.0, 2.0, 2.0, 1.0) : vec4(pixel / size * 2.0 - 1.0, 0.0, 1.0);
}
