// Media in the cells of a grid: core/indirect/media.py; layout of ps_media: render/indirect/media.py, PS_MEDIA_WIDTH cells in a
// row of the texture. Rays go from cell to cell, each of which is the same throughout (Amanatides and Woo 1987), so that what they
// find changes smoothly as they move.

#define PS_MOST_CELLS 300  // that a ray meets
#define PS_OPAQUE_MEDIA 1e-3  // of light, below which nothing is seen any more

struct PsMarch {
  vec3 before;  // radiance that media send, before a surface at some distance
  float left_before;  // share of light that comes through from there
  vec3 all;  // the same without the surface
  float left;
};

PsMarch ps_march(vec3 origin, vec3 direction, float surface)
{
  vec3 count = vec3(u.media_cells.xyz), at = (origin - u.media_corner.xyz) / u.media_corner.w;
  vec3 d = mix(direction, vec3(1e-7), lessThan(abs(direction), vec3(1e-7))), inverse = 1.0 / d;
  vec3 first = -at * inverse, second = (count - at) * inverse, enter = min(first, second), leave = max(first, second);
  float t = max(max(enter.x, enter.y), max(enter.z, 0.0)), far = min(leave.x, min(leave.y, leave.z));
  float end_surface = surface / u.media_corner.w, edge = u.media_corner.w;
  vec3 forwards = step(vec3(0.0), d), turn = 2.0 * forwards - 1.0;
  vec3 cell = clamp(floor(at + t * d), vec3(0.0), count - 1.0);
  vec3 next = (cell + forwards - at) * inverse;
  PsMarch found = PsMarch(vec3(0.0), 1.0, vec3(0.0), 1.0);
  for (int i = 0; i < PS_MOST_CELLS && t < far && found.left > PS_OPAQUE_MEDIA; i++) {
    int number = int(cell.x + count.x * (cell.y + count.y * cell.z));
    vec4 medium = texelFetch(ps_media, ivec2(number & (PS_MEDIA_WIDTH - 1), number / PS_MEDIA_WIDTH), 0);
    float end = min(min(next.x, next.y), min(next.z, far)), length = max(end - t, 0.0) * edge, depth = medium.a * length;
    float passed = exp(-depth);
    vec3 sent = found.left * medium.rgb * (depth > 1e-3 ? (1.0 - passed) / medium.a : length * (1.0 - 0.5 * depth));
    float part = clamp((end_surface - t) / max(end - t, 1e-9), 0.0, 1.0);
    found.before += part * sent;
    found.left_before *= mix(1.0, passed, part);
    found.all += sent;
    found.left *= passed;
    vec3 step_along = vec3(lessThanEqual(next, vec3(end)));
    cell = clamp(cell + turn * step_along, vec3(0.0), count - 1.0);
    next += abs(inverse) * step_along;
    t = end;
  }
  return found;
}
