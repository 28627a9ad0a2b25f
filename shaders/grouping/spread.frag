// The picture from the shaded groups, by the pixel filter: each pixel takes from its neighbours and from itself what
// their sub-samples weigh. PS_REACH: pixels to the farthest of them. PS_WEIGHTS: the weights of sub-samples that lie on
// their lattice; else `ps_weights` holds them. PS_BEHIND: what open sub-samples show. PS_PLACES: groups are not listed in
// the order of their pixels. PS_AUXILIARY_ONLY: not Combined. PS_FOCUS: what is
// out of focus is left out, and the rest has its depth. PS_MOVED: the share of a neighbour's weight that is left to the pixel
// where each is of one group. u.corner: where in the picture the tile begins.

#include "lib/visibility/groups.glsl"

#define PS_SIDE (2 * PS_REACH + 1)
#define PS_NEIGHBOURS (PS_SIDE * PS_SIDE)

// What is left to the pixel is added as a difference, so that what is the same everywhere stays so to the last bit.
#ifdef PS_MOVED
#define PS_ADD(sum, values) \
  { \
    vec4 value = texelFetch(values, texel, 0); \
    sum += weight * value; \
    if (leaves > 0.0) { \
      sum += leaves * (texelFetch(values, own_texel, 0) - value); \
    } \
  }
#else
#define PS_ADD(sum, values) sum += weight * texelFetch(values, texel, 0);
#endif

// weight: of the values in `texel`; leaves: how much of it is left to those in `own_texel`.
void ps_add(float weight, ivec2 texel, float leaves, ivec2 own_texel)
{
#ifndef PS_AUXILIARY_ONLY
  PS_ADD(out_combined, ps_combined)
#endif
#ifdef PS_OUT_NORMAL
  PS_ADD(out_normal_pass, ps_normal_pass)
#endif
#ifdef PS_OUT_MIST
  PS_ADD(out_mist, ps_mist)
#endif
#ifdef PS_FOCUS
  PS_ADD(out_focus, ps_focus)
#endif
}

void main()
{
#ifndef PS_AUXILIARY_ONLY
  out_combined = vec4(0.0);
#endif
#ifdef PS_OUT_NORMAL
  out_normal_pass = vec4(0.0);
#endif
#ifdef PS_OUT_MIST
  out_mist = vec4(0.0);
#endif
#ifdef PS_FOCUS
  out_focus = vec4(0.0);
#endif
#ifdef PS_WEIGHTS
  const float weights[PS_NEIGHBOURS * PS_SUB_SAMPLES] = PS_WEIGHTS;
  const float sums[PS_NEIGHBOURS] = PS_WEIGHT_SUMS;
#endif
  ivec2 pixel = ivec2(gl_FragCoord.xy) - u.corner, last = textureSize(ps_second, 0) - 1;
  ivec2 away = ivec2(-PS_REACH);
  ivec2 own_texel = ivec2(0);
#ifdef PS_MOVED
  uvec2 own = uvec2(texelFetch(ps_first, pixel, 0).x, texelFetch(ps_second, pixel, 0).x);
  bool alone = (own.y & PS_UNIFORM) != 0u && ps_group_count(own) == 1;
  own_texel = ps_group_texel(int(texelFetch(ps_starts, pixel, 0).x));
#endif
  for (int q = 0; q < PS_NEIGHBOURS; q++) {
    ivec2 at = clamp(pixel + away, ivec2(0), last);
    away = away.x < PS_REACH ? ivec2(away.x + 1, away.y) : ivec2(-PS_REACH, away.y + 1);
    uvec2 codes = uvec2(texelFetch(ps_first, at, 0).x, texelFetch(ps_second, at, 0).x);
    bool whole = (codes.y & PS_UNIFORM) != 0u, open = (codes.y & PS_OPEN) != 0u;
    int count = ps_group_count(codes), first = int(texelFetch(ps_starts, at, 0).x);
    vec4 shares = vec4(0.0);  // weights of the groups
#ifdef PS_WEIGHTS
    shares.x = whole ? sums[q] : 0.0;
#else
    shares.x = whole ? texelFetch(ps_weights, ivec2(PS_SUB_SAMPLES, q), 0).x : 0.0;
#endif
    float leaves = 0.0;
#ifdef PS_MOVED
    leaves = alone && whole && count == 1 ? PS_MOVED * shares.x : 0.0;
#endif
    // A loop ends where no invocation goes on; both sides of a branch would be run.
    int separate = whole ? 0 : PS_SUB_SAMPLES;
    for (int i = 0; i < separate; i++) {
#ifdef PS_WEIGHTS
      float one = weights[q * PS_SUB_SAMPLES + i];
#else
      float one = texelFetch(ps_weights, ivec2(i, q), 0).x;
#endif
      shares += one * vec4(equal(uvec4(ps_group(codes, i)), uvec4(0u, 1u, 2u, 3u)));
    }
    float open_weight = 0.0;
    for (int layer = 0; layer < count; layer++) {
      float weight = layer == 0 ? shares.x : (layer == 1 ? shares.y : (layer == 2 ? shares.z : shares.w));
      open_weight -= weight;
      if (weight > 0.0) {
        ps_add(weight, ps_group_texel(first + layer), leaves, own_texel);
      }
    }
#ifdef PS_BEHIND
    if (open) {
#ifdef PS_WEIGHTS
      open_weight += sums[q];
#else
      open_weight += texelFetch(ps_weights, ivec2(PS_SUB_SAMPLES, q), 0).x;
#endif
#ifndef PS_AUXILIARY_ONLY
      out_combined += open_weight * texelFetch(ps_behind, at, 0);
#endif
#ifdef PS_OUT_MIST
      out_mist += vec4(open_weight);
#endif
    }
#endif
  }
}
