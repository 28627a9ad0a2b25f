// One level down the pyramid: pixels that are empty, or lie behind a surface that covers them, take the elliptical
// Gaussian mean of the four coarser splats around them (Marroquim et al. 2008, section 3.2). All others stay as they
// are: they are discarded before most of the work, which also software rasterisers skip then.
// PS_FINEST: into level 0, where what counts is the pixel's centre.

#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"

#ifdef PS_FINEST
// Whether the four splats around a pixel belong to one surface and the pixel's centre lies in the quadrilateral of
// theirs. Silhouettes do not grow by what is filled there.
bool ps_surrounded(vec4 a, vec4 b, vec4 c, vec4 d, vec2 toward)
{
  vec4 depth = vec4(a.x, b.x, c.x, d.x), reach = vec4(a.w, b.w, c.w, d.w);
  vec4 begin = depth - reach, end = depth + reach;
  float nearest = min(min(a.x, b.x), min(c.x, d.x));
  float front = a.x == nearest ? end.x : b.x == nearest ? end.y : c.x == nearest ? end.z : end.w;
  // Where a surface is steep, the farthest splat may overlap with the nearest only by way of others.
  for (int i = 0; i < 2; i++) {
    vec4 linked = mix(vec4(front), end, lessThanEqual(begin, vec4(front)));
    front = max(max(linked.x, linked.y), max(linked.z, linked.w));
  }
  vec4 x = toward.x * vec4(a.y, b.y, c.y, d.y) + vec4(-0.5, 1.5, -0.5, 1.5);
  vec4 y = toward.y * vec4(a.z, b.z, c.z, d.z) + vec4(-0.5, -0.5, 1.5, 1.5);
  vec4 across = x.xywz * y.ywzx - y.xywz * x.ywzx;
  return all(greaterThan(reach, vec4(0.0))) && all(greaterThan(across, vec4(0.0))) &&
         all(lessThanEqual(begin, vec4(front)));
}

// How far nearer splats enclose this pixel, where two that face each other are nearer to each other than to what is seen
// between them. 2: they hold all four sides. 1: three sides of a pixel that shows something; against nothing, notches of
// an outline stay open. 0: they do not. On steep surfaces the splats that won their pixels do not touch any more.
int ps_enclosed(ivec2 pixel, float own_front)
{
  ivec2 last = textureSize(ps_front, 0) - 1;
  vec4 near = vec4(texelFetch(ps_front, ivec2(max(pixel.x - 1, 0), pixel.y), 0).x,
                   texelFetch(ps_front, ivec2(pixel.x, max(pixel.y - 1, 0)), 0).x,
                   texelFetch(ps_front, ivec2(min(pixel.x + 1, last.x), pixel.y), 0).x,
                   texelFetch(ps_front, ivec2(pixel.x, min(pixel.y + 1, last.y)), 0).x);
  vec2 farther = max(near.xy, near.zw), nearer = min(near.xy, near.zw);
  float own = own_front - u.near;
  bvec2 linked = lessThan(2.0 * farther - nearer, vec2(own));
  bool between = (nearer.x > 0.0 && linked.x) || (nearer.y > 0.0 && linked.y);
  float sides = dot(vec4(greaterThan(near, vec4(0.0))) * vec4(lessThan(near, vec4(own))), vec4(1.0));
  return !between ? 0 : sides > 3.5 ? 2 : sides > 2.5 && own_front < 1e37 ? 1 : 0;
}
#endif

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  float own_front = texelFetch(ps_front, pixel, 0).x;
  own_front = own_front == 0.0 ? 1e38 : own_front + u.near;

  // The four coarser pixels around this one: the parent, and its neighbours on this pixel's side.
  ivec2 parent = pixel >> 1;
  ivec2 toward = (pixel & 1) * 2 - 1;
  ivec2 last = textureSize(ps_coarse_centre, 0) - 1;
  ivec2 beside = clamp(parent + toward, ivec2(0), last);
  ivec2 at[4] = ivec2[4](parent, ivec2(beside.x, parent.y), ivec2(parent.x, beside.y), beside);
  vec4 centre[4];
  float front = 1e38;
  for (int i = 0; i < 4; i++) {
    centre[i] = texelFetch(ps_coarse_centre, at[i], 0);
    front = centre[i].w > 0.0 ? min(front, centre[i].x + centre[i].w) : front;
  }
  if (front >= own_front) {
    discard;
  }

  // Between levels a splat must not miss a pixel that it touches. At the end, where the pixel's centre is what counts,
  // splats may be too small to reach it from all sides: a surface goes on between the centres of its splats.
  float side = float(1 << u.level);
#ifdef PS_FINEST
  // Where it does so on all four sides, it goes on however thin its splats are.
  bool inside = ps_surrounded(centre[0], centre[1], centre[2], centre[3], vec2(toward));
  int enclosed = ps_enclosed(pixel, own_front);
  float slack = enclosed == 2 ? 1.0 : inside || enclosed == 1 ? 0.25 : 0.0;
#else
  float slack = side * side * 0.125;
#endif
  vec4 shape[4];
  float weight[4];
  float nearest = 1e38;
  front = 1e38;
  for (int i = 0; i < 4; i++) {
    weight[i] = 0.0;
    // At the picture's rim a neighbour is the parent again.
    bool again = (i == 1 && at[1] == at[0]) || (i == 2 && at[2] == at[0]) ||
                 (i == 3 && (at[3] == at[1] || at[3] == at[2]));
    if (centre[i].w > 0.0 && !again) {
      shape[i] = texelFetch(ps_coarse_shape, at[i], 0);
      // From the splat's centre to this pixel's.
      vec2 v = (vec2(pixel) + 0.5) * side - (vec2(at[i]) + 0.5) * 2.0 * side - centre[i].yz;
      vec3 c = ps_covariance(shape[i].xyz);
      c.xz += slack;
      float m = (c.z * v.x * v.x - 2.0 * c.y * v.x * v.y + c.x * v.y * v.y) / max(c.x * c.z - c.y * c.y, 1e-12);
      if (m <= PS_RIM) {
        weight[i] = exp(-0.5 * m);
        if (centre[i].x < nearest) {
          nearest = centre[i].x;
          front = centre[i].x + centre[i].w;
        }
      }
    }
  }
  if (front >= own_front) {
    discard;
  }

  PsSurfel s = ps_empty();
  float total = 0.0, best = 0.0, near_end = 1e38, far_end = -1e38;
  for (int i = 0; i < 4; i++) {
    if (weight[i] > 0.0 && centre[i].x - centre[i].w <= front) {
      float w = weight[i];
      total += w;
      vec2 offset = centre[i].yz + (vec2(at[i]) + 0.5) * 2.0 * side - (vec2(pixel) + 0.5) * side;
      s.centre.xyz += w * vec3(centre[i].x, offset);
      near_end = min(near_end, centre[i].x - centre[i].w);
      far_end = max(far_end, centre[i].x + centre[i].w);
      // Means of Cholesky factors are factors again.
      s.shape.xyz += w * shape[i].xyz;
#ifdef PS_NORMAL
      s.normal += w * texelFetch(ps_coarse_normal, at[i], 0);
#endif
      // Identities cannot be mixed: the heaviest splat's.
      bool heaviest = w > best;
      best = max(best, w);
      s.shape.w = heaviest ? shape[i].w : s.shape.w;
#ifdef PS_COLOR
      s.color += w * texelFetch(ps_coarse_color, at[i], 0);
#endif
#ifdef PS_EMISSION
      s.emission += w * texelFetch(ps_coarse_emission, at[i], 0);
#endif
#if defined(PS_VELOCITY)
      vec4 moving = texelFetch(ps_coarse_owner, at[i], 0);
      s.owner = heaviest ? uint(int(moving.x)) : s.owner;
      s.velocity = heaviest ? moving.yzw : s.velocity;
#elif defined(PS_OWNER)
      s.owner = heaviest ? texelFetch(ps_coarse_owner, at[i], 0).x : s.owner;
#endif
    }
  }
  float scale = 1.0 / total;
  s.centre.xyz *= scale;
  s.centre.w = max(far_end - s.centre.x, s.centre.x - near_end);
  s.shape.xyz *= scale;
#ifdef PS_NORMAL
  s.normal *= scale;
#endif
#ifdef PS_COLOR
  s.color *= scale;
#endif
#ifdef PS_EMISSION
  s.emission *= scale;
#endif
  ps_store(s);
}
