// Whether a projected splat is needed, for what `visibility` found of some of them: PS_EWA_HIDDEN, where all of it lies
// behind that; PS_EWA_COVERED, where it may be blended, but its ellipse is covered by a surface that it belongs to or lies
// behind, at its middle and at eight places near the kernel's end; else PS_EWA_NEEDED. Layout: render/passes/ewa/cover.py.

#include "lib/splat/ewa.glsl"

#define PS_EWA_HIDDEN 0.0
#define PS_EWA_COVERED 1.0
#define PS_EWA_NEEDED 2.0
#define PS_OPEN 3e38

// The farthest depth of what is nearest within `side` pixels of `middle`, or PS_OPEN.
float ps_farthest(vec2 middle, vec2 side)
{
  ivec2 last = ivec2(u.size) - 1;
  ivec2 low = clamp(ivec2(floor(middle - side)), ivec2(0), last) >> u.shift;
  ivec2 high = clamp(ivec2(floor(middle + side)), ivec2(0), last) >> u.shift;
  ivec2 other = max(low, high - u.window + 1);
  float one = max(texelFetch(ps_open, low, 0).x, texelFetch(ps_open, other, 0).x);
  float two = max(texelFetch(ps_open, ivec2(low.x, other.y), 0).x, texelFetch(ps_open, ivec2(other.x, low.y), 0).x);
  return all(lessThan(high - low, ivec2(2 * u.window))) ? max(one, two) : PS_OPEN;
}

void main()
{
  ivec2 at = ivec2(gl_FragCoord.xy), last = ivec2(u.size) - 1;
  vec4 centre = texelFetch(ps_splat_centre, at, 0), front = texelFetch(ps_splat_front, at, 0);
  vec3 c = texelFetch(ps_splat_shape, at, 0).xyz;
  vec2 middle = centre.xy + u.principal_point;
  bool back = centre.w < 0.0;
  float margin = u.margin, tolerance = back ? 0.0 : u.tolerance * front.w, low_pass = u.low_pass;
  // Axes of the covariance, one standard deviation long, and of that of the kernel.
  float mean = 0.5 * (c.x + c.z), apart = length(vec2(0.5 * (c.x - c.z), c.y));
  vec2 axis = c.x > c.z ? vec2(c.x - mean + apart, c.y) : vec2(c.y, c.z - mean + apart);
  axis = apart > 1e-9 * mean ? normalize(axis) : vec2(1.0, 0.0);
  vec2 across = vec2(-axis.y, axis.x), variance = max(vec2(mean + apart, mean - apart), 0.0);
  vec2 rim = 1.05 * sqrt(ps_ewa_rim(front.z)) * sqrt(variance + low_pass) + margin;
  bool covered = true;
  for (int i = 0; i < 9; i++) {
    vec2 sides = vec2(i % 3, i / 3) - 1.0;
    sides *= (abs(sides.x) + abs(sides.y) > 1.5 ? 0.70710678 : 1.0) * rim;
    ivec2 pixel = clamp(ivec2(floor(middle + sides.x * axis + sides.y * across)), ivec2(0), last);
    vec2 seen = texelFetch(ps_nearest, pixel, 0).xy;
    float depth = centre.z + dot(front.xy, vec2(pixel) + 0.5 - middle);
    bool open = !(seen.x > 0.0);
    covered = covered && !open && depth - u.near + tolerance >= seen.x;
  }
  vec2 side = max(PS_EWA_CUTOFF_SIGMA, sqrt(ps_ewa_rim(front.z))) * sqrt(c.xz + low_pass) + margin;
  float farthest = ps_farthest(middle, side);
  bool closed = farthest < PS_OPEN;
  // All of it, wherever something nearer ends within its reach.
  bool hidden = centre.z - dot(abs(front.xy), side) - front.w > farthest;
#ifdef PS_THIN
  covered = covered && (back || closed);
#else
  covered = covered && closed;
#endif
  out_needed = hidden ? PS_EWA_HIDDEN : covered ? PS_EWA_COVERED : PS_EWA_NEEDED;
}
