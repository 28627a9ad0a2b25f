// Tubes: what pixels' rays meet of the hull of two balls, of which neighbouring segments share one. References:
// tests/render/passes/test_strands_pictures.py.

#include "lib/geometry/camera.glsl"

#define PS_FIBRE_PIXELS 2.0  // of width: what is narrower is shaded as a whole

// The hull of two balls, (centre, radius), cut off by the planes in which the strand ends: what is kept has
// dot(plane.xyz, p) + plane.w >= 0.
struct PsTube {
  vec4 from, to;
  vec4 begin, end;
};

struct PsHit {
  float d;  // parameter of the ray: the depth; 1e38: none
  float along;  // 0 at the first end, 1 at the second
  vec3 normal;
};

struct PsRay {
  vec3 eye, direction;
};

// Takes what lies in the picture, between the ends of the strand, and before all that was found.
void ps_meet(inout PsHit hit, PsRay ray, PsTube tube, float d, float along, vec3 normal, bool there)
{
  if (there && d >= u.near && d < hit.d) {
    vec3 p = ray.eye + d * ray.direction;
    if (dot(tube.begin.xyz, p) + tube.begin.w >= 0.0 && dot(tube.end.xyz, p) + tube.end.w >= 0.0) {
      hit = PsHit(d, along, normal);
    }
  }
}

// The plane that closes a strand at this end of the segment, if it is the strand's. Its inside is seen where the near
// plane cuts a tube open.
void ps_meet_end(inout PsHit hit, PsRay ray, vec3 middle, float radius, vec4 plane, float along)
{
  float through = dot(plane.xyz, ray.direction), d = -(dot(plane.xyz, ray.eye) + plane.w) / through;
  vec3 to = ray.eye + d * ray.direction - middle;
  if (through != 0.0 && abs(dot(plane.xyz, middle) + plane.w) <= 1e-3 * radius && dot(to, to) <= radius * radius &&
      d >= u.near && d < hit.d) {
    hit = PsHit(d, along, -plane.xyz);
  }
}

// From the point of the ray that is nearest to the middle, so that what is far keeps its digits.
void ps_meet_ball(inout PsHit hit, PsRay ray, PsTube tube, vec4 ball, vec3 axis, float turn, float bend, float along)
{
  vec3 to = ray.eye - ball.xyz;
  float a = dot(ray.direction, ray.direction), middle = -dot(to, ray.direction) / a;
  vec3 nearest = to + middle * ray.direction;
  float outside = ball.w * ball.w - dot(nearest, nearest);
  float chord = sqrt(max(outside, 0.0) / a);
  for (int i = 0; i < 2; i++) {
    float t = i == 0 ? -chord : chord;
    vec3 n = nearest + t * ray.direction;
    // Beyond the circle where the cone touches the ball.
    ps_meet(hit, ray, tube, middle + t, along, n, outside >= 0.0 && (dot(n, axis) - ball.w * bend) * turn >= 0.0);
  }
}

PsHit ps_meet_tube(vec2 pixel, PsTube tube)
{
  vec4 a = tube.from, b = tube.to;
  vec3 here = ps_view_from_pixel(pixel, 1.0);
  vec3 eye = ps_is_perspective() ? vec3(0.0) : vec3(here.xy, 0.0);
  vec3 direction = ps_is_perspective() ? here : vec3(0.0, 0.0, -1.0);
  PsRay ray = PsRay(eye, direction);
  vec3 axis = b.xyz - a.xyz;
  float len = length(axis);
  PsHit hit = PsHit(1e38, 0.0, vec3(0.0));
  // A ball within the other.
  if (len <= abs(a.w - b.w) * 1.0001 + 1e-30) {
    ps_meet_ball(hit, ray, tube, a.w >= b.w ? a : b, vec3(0.0), 1.0, 0.0, a.w >= b.w ? 0.0 : 1.0);
    ps_meet_end(hit, ray, a.xyz, a.w, tube.begin, 0.0);
    ps_meet_end(hit, ray, b.xyz, b.w, tube.end, 1.0);
    return hit;
  }
  axis /= len;
  float bend = (a.w - b.w) / len, cosine = sqrt(1.0 - bend * bend), slope = bend / cosine;
  ps_meet_ball(hit, ray, tube, a, axis, -1.0, bend, 0.0);
  ps_meet_ball(hit, ray, tube, b, axis, 1.0, bend, 1.0);
  // Where a strand widens from its end on, the cone is wider there than the ball.
  ps_meet_end(hit, ray, a.xyz, bend < 0.0 ? a.w / cosine : a.w, tube.begin, 0.0);
  ps_meet_end(hit, ray, b.xyz, bend > 0.0 ? b.w / cosine : b.w, tube.end, 1.0);

  // The cone that touches both, from the point of the ray that is nearest to its axis: its radius is
  // a.w / cosine - slope y at the distance y along the axis.
  vec3 to = eye - a.xyz, e = direction - dot(direction, axis) * axis;
  float e2 = dot(e, e), square = dot(direction, direction);
  float middle = e2 > 1e-12 * square ? -dot(to, e) / e2 : -dot(to, direction) / square;
  to += middle * direction;
  float y = dot(to, axis), m = dot(direction, axis);
  vec3 o = to - y * axis;
  float g = a.w / cosine - slope * y, s = slope * m;
  float qa = e2 - s * s, qb = dot(o, e) + s * g, qc = dot(o, o) - g * g;
  float root = qb * qb - qa * qc;
  float far = -qb - (qb < 0.0 ? -1.0 : 1.0) * sqrt(max(root, 0.0));
  for (int i = 0; i < 2; i++) {
    float t = i == 0 ? far / qa : qc / far;
    float at = y + t * m;
    bool there = root >= 0.0 && g - s * t >= 0.0 && at >= a.w * bend && at <= len + b.w * bend;
    ps_meet(hit, ray, tube, middle + t, clamp(at / len, 0.0, 1.0), cosine * normalize(o + t * e) + bend * axis, there);
  }
  return hit;
}
