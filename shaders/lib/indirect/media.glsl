// Media in the cells of a grid: core/indirect/media.py; layout of ps_media: render/indirect/media.py, PS_MEDIA_WIDTH cells in a
// row of the texture. PS_MEDIA_COLORED: channels
// differ in extinction. Rays go from cell to cell, each of which is the same throughout (Amanatides and Woo 1987), so that what they
// find changes smoothly as they move.

#define PS_MOST_CELLS 300  // that a ray meets
#define PS_OPAQUE_MEDIA 1e-3  // of light, below which nothing is seen any more

#ifdef PS_MEDIA_COLORED
#define PS_SHARE vec3
#else
#define PS_SHARE float
#endif

struct PsMarch {
  vec3 before;  // radiance that media send, before a surface at some distance
  PS_SHARE left_before;  // share of light that comes through from there
  vec3 all;  // the same without the surface
  PS_SHARE left;
};

float ps_most_left(float left)
{
  return left;
}

float ps_most_left(vec3 left)
{
  return max(left.r, max(left.g, left.b));
}

// The mean of what is left along a way of this optical depth.
float ps_mean_left(float depth)
{
  return depth > 1e-3 ? (1.0 - exp(-depth)) / depth : 1.0 - 0.5 * depth;
}

vec3 ps_mean_left(vec3 depth)
{
  return vec3(ps_mean_left(depth.r), ps_mean_left(depth.g), ps_mean_left(depth.b));
}

// A ray in the grid, in cells.
struct PsRay {
  vec3 turn, apart;  // the way that it goes along each axis, and how far apart the borders are that it meets
  vec3 cell, next;  // where it is, and how far away the next border along each axis is
  float t, far;  // how far it has come, and where it leaves the grid
};

void ps_march_on(inout PsMarch found, inout PsRay ray, vec3 count, float surface)
{
  int number = int(ray.cell.x + count.x * (ray.cell.y + count.y * ray.cell.z));
  ivec2 at = ivec2(number & (PS_MEDIA_WIDTH - 1), number / PS_MEDIA_WIDTH);
#ifdef PS_MEDIA_COLORED
  at.x *= 2;
  vec3 sends = texelFetch(ps_media, at, 0).rgb, extinction = texelFetch(ps_media, at + ivec2(1, 0), 0).rgb;
#else
  vec4 medium = texelFetch(ps_media, at, 0);
  vec3 sends = medium.rgb;
  float extinction = medium.a;
#endif
#ifdef PS_OCCLUSION
  sends = vec3(0.0);
#endif
  float end = min(min(ray.next.x, ray.next.y), min(ray.next.z, ray.far));
  float length = max(end - ray.t, 0.0) * u.media_corner.w;
  PS_SHARE depth = extinction * length, passed = exp(-depth);
  vec3 sent = found.left * sends * (length * ps_mean_left(depth));
  float part = clamp((surface - ray.t) / max(end - ray.t, 1e-9), 0.0, 1.0);
  found.before += part * sent;
  found.left_before *= mix(PS_SHARE(1.0), passed, part);
  found.all += sent;
  found.left *= passed;
  vec3 on = vec3(lessThanEqual(ray.next, vec3(end)));
  ray.cell = clamp(ray.cell + ray.turn * on, vec3(0.0), count - 1.0);
  ray.next += ray.apart * on;
  ray.t = end;
}

// `surface`: its distance from the origin.
PsMarch ps_march(vec3 origin, vec3 direction, float surface)
{
  vec3 count = vec3(u.media_cells.xyz), at = (origin - u.media_corner.xyz) / u.media_corner.w;
  vec3 d = mix(direction, vec3(1e-7), lessThan(abs(direction), vec3(1e-7))), inverse = 1.0 / d;
  vec3 first = -at * inverse, second = (count - at) * inverse, enter = min(first, second), leave = max(first, second);
  vec3 forwards = step(vec3(0.0), d);
  PsRay ray;
  ray.t = max(max(enter.x, enter.y), max(enter.z, 0.0));
  ray.far = min(leave.x, min(leave.y, leave.z));
  ray.turn = 2.0 * forwards - 1.0;
  ray.apart = abs(inverse);
  ray.cell = clamp(floor(at + ray.t * d), vec3(0.0), count - 1.0);
  ray.next = (ray.cell + forwards - at) * inverse;
#ifdef PS_OCCLUSION
  ray.far = min(ray.far, u.within / u.media_corner.w);
#endif
  PsMarch found = PsMarch(vec3(0.0), PS_SHARE(1.0), vec3(0.0), PS_SHARE(1.0));
  float before = surface / u.media_corner.w;
  // Four cells at a turn: software rasterisers end all loops together after 65,535 turns.
  for (int i = 0; i < PS_MOST_CELLS / 4 && ray.t < ray.far && ps_most_left(found.left) > PS_OPAQUE_MEDIA; i++) {
    ps_march_on(found, ray, count, before);
    ps_march_on(found, ray, count, before);
    ps_march_on(found, ray, count, before);
    ps_march_on(found, ray, count, before);
  }
  return found;
}
