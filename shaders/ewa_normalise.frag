// Sums over their weights: the surface of each pixel into the G-buffer. Where no ellipse holds the pixel's centre, but
// kernels reach it, what they show lies beside: it counts as far as they cover the pixel (lib/coverage.glsl), and hides
// no polygon.

#include "lib/camera.glsl"
#include "lib/ewa.glsl"
#include "lib/surfel.glsl"
#include "lib/store.glsl"

// The material beside a pixel whose centre no ellipse holds: a neighbour's, else the mean row of what reaches it.
float ps_material_beside(ivec2 pixel, float mean)
{
  ivec2 last = textureSize(ps_nearest, 0) - 1;
  for (int i = 0; i < 9; i++) {
    ivec2 at = clamp(pixel + ivec2(i % 3, i / 3) - 1, ivec2(0), last);
    vec4 nearest = texelFetch(ps_nearest, at, 0);
    if (nearest.x > 0.0) {
      return nearest.z;
    }
  }
  return floor(mean + 0.5);
}

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec4 sum = texelFetch(ps_sum_place, pixel, 0);
  vec4 nearest = texelFetch(ps_nearest, pixel, 0);
  bool covers = nearest.x > 0.0;
  if (!(sum.w > 0.0)) {
    discard;
  }
  float scale = 1.0 / sum.w;
  float d = sum.x * scale, reach = max(nearest.y - nearest.x, 1e-30);
  PsSurfel s = ps_empty();
  s.place = vec4(d, 0.0, 0.0, covers ? reach : -reach);
  s.shape.x = min(max(sum.z, (sum.w - sum.z) / PS_EWA_BACK), 1.0);
  s.shape.w = nearest.z;
  if (!covers) {
    s.shape.w = ps_material_beside(pixel, sum.y * scale);
  }
#ifdef PS_NORMAL
  s.normal = scale * texelFetch(ps_sum_normal, pixel, 0);
#endif
#ifdef PS_COLOR
  s.color = scale * texelFetch(ps_sum_color, pixel, 0);
#endif
#ifdef PS_EMISSION
  s.emission = scale * texelFetch(ps_sum_emission, pixel, 0);
#endif
#ifdef PS_OWNER
  s.owner = covers ? uint(nearest.w) : 0xFFFFFFFFu;
#endif
  ps_store_front(s, covers);
#ifdef PS_DEPTH
  gl_FragDepth = covers ? ps_buffer_depth(d) : 1.0;
#endif
}
