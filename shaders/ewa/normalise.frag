// Sums over their weights: the surface of each pixel into the G-buffer. Where no ellipse holds the pixel's centre, but
// kernels reach it, what they show lies beside: it counts as far as they cover the pixel (lib/geometry/coverage.glsl), and hides
// no polygon. PS_HARD: samples are many, and it shows nothing.

#include "lib/geometry/camera.glsl"
#include "lib/splat/ewa.glsl"
#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"

// What is seen around a pixel whose centre no ellipse holds, fronts before backs; (0, 0, 0, 0): nothing.
vec4 ps_seen_around(ivec2 pixel)
{
  ivec2 last = textureSize(ps_nearest, 0) - 1;
  vec4 found = vec4(0.0);
  for (int i = 0; i < 9; i++) {
    vec4 nearest = texelFetch(ps_nearest, clamp(pixel + ivec2(i % 3, i / 3) - 1, ivec2(0), last), 0);
    if (nearest.x > 0.0 && !ps_back_seen(nearest)) {
      return nearest;
    }
    found = nearest.x > 0.0 ? nearest : found;
  }
  return found;
}

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec4 sum = texelFetch(ps_sum_depth, pixel, 0);
  vec4 nearest = texelFetch(ps_nearest, pixel, 0);
  bool covers = nearest.x > 0.0;
#ifdef PS_HARD
  bool shows = covers;
#else
  bool shows = true;
#endif
  if (!shows || !(sum.w > 0.0)) {
    discard;
  }
  float scale = 1.0 / sum.w;
  float d = sum.x * scale, reach = max(nearest.y - u.near - nearest.x, 1e-30);
  PsSurfel s = ps_empty();
  s.centre = vec4(d, 0.0, 0.0, covers ? reach : -reach);
  float front = sum.z, back = (sum.w - sum.z) / (ps_back_seen(nearest) ? 1.0 : PS_EWA_BACK);
  s.shape.x = PS_EWA_WITHIN * max(front, back);
  s.shape.w = nearest.z;
  if (!covers) {
    vec4 beside = ps_seen_around(pixel);
    bool alone = beside.x == 0.0;
    s.shape.w = alone ? floor(sum.y * scale + 0.5) : beside.z;
    // What is seen from one side is not widened by its other side.
    s.shape.x = alone ? max(front, back) : ps_back_seen(beside) ? back : front;
  }
  s.shape.x = min(s.shape.x, 1.0);
#ifdef PS_NORMAL
  s.normal = scale * texelFetch(ps_sum_normal, pixel, 0);
#endif
#ifdef PS_COLOR
  s.color = scale * texelFetch(ps_sum_color, pixel, 0);
#endif
#ifdef PS_EMISSION
  s.emission = scale * texelFetch(ps_sum_emission, pixel, 0);
#endif
#ifdef PS_VELOCITY
  s.velocity = scale * texelFetch(ps_sum_velocity, pixel, 0).xyz;
#endif
#ifdef PS_OWNER
  s.owner = covers ? uint(nearest.w) >> 1 : 0xFFFFFFFFu;
#endif
  ps_store_front(s, covers);
#ifdef PS_DEPTH
  gl_FragDepth = covers ? ps_buffer_depth(d) : 1.0;
#endif
}
