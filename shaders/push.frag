// One level down: a pixel keeps what it has unless a nearer surface covers it; holes take the elliptical Gaussian mean
// of the four coarser splats around them (Marroquim et al. 2008, section 3.2).

#include "lib/surfel.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  int level = frame.size.z;
  float side = float(1 << level);
  vec4 own = texelFetch(ps_place, pixel, 0);
  vec4 own_shape = own.w > 0.0 ? texelFetch(ps_shape, pixel, 0) : vec4(0.0);
  // Between levels a splat must not miss a pixel that it touches; at the end, what counts is the pixel's centre.
  float slack = level > 0 ? side * side * 0.125 : 0.0;

  // The four coarser pixels around this one: the parent, and its neighbours on this pixel's side.
  ivec2 toward = (pixel & 1) * 2 - 1;
  ivec2 last = textureSize(ps_coarse_place, 0) - 1;
  vec4 place[4];
  vec4 shape[4];
  float weight[4];
  float nearest = 1e38, front = 1e38;
  for (int i = 0; i < 4; i++) {
    ivec2 coarse = pixel / 2 + ivec2(i & 1, i >> 1) * toward;
    weight[i] = 0.0;
    if (all(greaterThanEqual(coarse, ivec2(0))) && all(lessThanEqual(coarse, last))) {
      place[i] = texelFetch(ps_coarse_place, coarse, 0);
      if (place[i].w > 0.0) {
        shape[i] = texelFetch(ps_coarse_shape, coarse, 0);
        // From the splat's centre to this pixel's.
        vec2 v = (vec2(pixel) + 0.5) * side - (vec2(coarse) + 0.5) * 2.0 * side - place[i].yz;
        vec3 c = ps_covariance(shape[i].xyz);
        c.xz += slack;
        float m = ps_mahalanobis(ps_cholesky(c), v);
        if (m <= PS_RIM) {
          weight[i] = exp(-0.5 * m);
          if (place[i].x < nearest) {
            nearest = place[i].x;
            front = place[i].x + place[i].w;
          }
        }
      }
    }
  }

  bool there = own.w != 0.0;
  // A polygon, or a splat that reaches the pixel's centre.
  bool covers = own.w < 0.0 || (own.w > 0.0 && (level > 0 || ps_mahalanobis(own_shape.xyz, own.yz) <= PS_RIM));
  float own_front = own.w > 0.0 ? own.x - own.w : own.x;
  bool hidden = there && own_front > front;
  if (covers && !hidden) {
    PsSurfel s = ps_empty();
    s.place = own;
    s.shape = texelFetch(ps_shape, pixel, 0);
    s.normal = texelFetch(ps_normal, pixel, 0);
#ifdef PS_COLOR
    s.color = texelFetch(ps_color, pixel, 0);
#endif
#ifdef PS_EMISSION
    s.emission = texelFetch(ps_emission, pixel, 0);
#endif
#ifdef PS_OWNER
    s.owner = texelFetch(ps_owner, pixel, 0).x;
#endif
    ps_store(s);
    return;
  }

  PsSurfel s = ps_empty();
  float total = 0.0, best = 0.0, near_end = 1e38, far_end = -1e38;
  vec3 second = vec3(0.0);
  for (int i = 0; i < 4; i++) {
    if (weight[i] > 0.0 && place[i].x - place[i].w <= front) {
      ivec2 coarse = pixel / 2 + ivec2(i & 1, i >> 1) * toward;
      float w = weight[i];
      total += w;
      vec2 offset = place[i].yz + (vec2(coarse) + 0.5) * 2.0 * side - (vec2(pixel) + 0.5) * side;
      s.place.xyz += w * vec3(place[i].x, offset);
      near_end = min(near_end, place[i].x - place[i].w);
      far_end = max(far_end, place[i].x + place[i].w);
      second += w * ps_covariance(shape[i].xyz);
      s.normal += w * texelFetch(ps_coarse_normal, coarse, 0);
      bool heaviest = w > best;
      best = max(best, w);
      s.shape.w = heaviest ? shape[i].w : s.shape.w;
#ifdef PS_COLOR
      s.color += w * texelFetch(ps_coarse_color, coarse, 0);
#endif
#ifdef PS_EMISSION
      s.emission += w * texelFetch(ps_coarse_emission, coarse, 0);
#endif
#ifdef PS_OWNER
      s.owner = heaviest ? texelFetch(ps_coarse_owner, coarse, 0).x : s.owner;
#endif
    }
  }
  if (total > 0.0) {
    s.place.xyz /= total;
    s.place.w = max(far_end - s.place.x, s.place.x - near_end);
    s.shape.xyz = ps_cholesky(second / total);
    s.normal /= total;
#ifdef PS_COLOR
    s.color /= total;
#endif
#ifdef PS_EMISSION
    s.emission /= total;
#endif
  }
  ps_store(s);
}
