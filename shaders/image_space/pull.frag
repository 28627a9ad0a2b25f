// One level up: the mean of those of four splats that belong to the nearest surface, with matched moments
// (Marroquim et al. 2008, section 3.1; there without the spread of the centres, which leaves holes between them).

#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"

void main()
{
  ivec2 parent = ivec2(gl_FragCoord.xy);
  ivec2 last = textureSize(ps_centre, 0) - 1;
  float half_child = float(1 << u.level) * 0.25;  // half a child's side; u.level is the level written
  vec4 centre[4];
  float front = 1e38, nearest = 1e38;
  for (int i = 0; i < 4; i++) {
    ivec2 child = 2 * parent + ivec2(i & 1, i >> 1);
    centre[i] = all(lessThanEqual(child, last)) ? texelFetch(ps_centre, child, 0) : vec4(0.0);
    centre[i].w = centre[i].w <= PS_POLYGON ? 0.0 : abs(centre[i].w);
    if (centre[i].w > 0.0 && centre[i].x < nearest) {
      nearest = centre[i].x;
      front = centre[i].x + centre[i].w;
    }
  }
  if (nearest >= 1e38) {
    discard;
  }
  PsSurfel s = ps_empty();
  {
    float count = 0.0, near_end = 1e38, far_end = -1e38;
    vec3 second = vec3(0.0);
    vec2 first = vec2(0.0);
    for (int i = 0; i < 4; i++) {
      if (centre[i].w > 0.0 && centre[i].x - centre[i].w <= front) {
        ivec2 child = 2 * parent + ivec2(i & 1, i >> 1);
        vec2 offset = centre[i].yz + (vec2(i & 1, i >> 1) * 2.0 - 1.0) * half_child;
        vec4 shape = texelFetch(ps_shape, child, 0);
        count += 1.0;
        first += offset;
        second += ps_covariance(shape.xyz) + vec3(offset.x * offset.x, offset.x * offset.y, offset.y * offset.y);
        near_end = min(near_end, centre[i].x - centre[i].w);
        far_end = max(far_end, centre[i].x + centre[i].w);
        s.centre.x += centre[i].x;
#ifdef PS_NORMAL
        s.normal += texelFetch(ps_normal, child, 0);
#endif
        // Identities cannot be mixed: the nearest splat's.
        bool best = centre[i].x == nearest;
        s.shape.w = best ? shape.w : s.shape.w;
#ifdef PS_COLOR
        s.color += texelFetch(ps_color, child, 0);
#endif
#ifdef PS_EMISSION
        s.emission += texelFetch(ps_emission, child, 0);
#endif
#if defined(PS_VELOCITY)
        vec4 moving = texelFetch(ps_owner, child, 0);
        s.owner = best ? uint(int(moving.x)) : s.owner;
        s.velocity = best ? moving.yzw : s.velocity;
#elif defined(PS_OWNER)
        s.owner = best ? texelFetch(ps_owner, child, 0).x : s.owner;
#endif
      }
    }
    float weight = 1.0 / count;
    first *= weight;
    second = second * weight - vec3(first.x * first.x, first.x * first.y, first.y * first.y);
    float d = s.centre.x * weight;
    s.centre = vec4(d, first, max(far_end - d, d - near_end));
    s.shape.xyz = ps_cholesky(second);
#ifdef PS_NORMAL
    s.normal *= weight;
#endif
#ifdef PS_COLOR
    s.color *= weight;
#endif
#ifdef PS_EMISSION
    s.emission *= weight;
#endif
  }
  ps_store_front(s, true);
}
