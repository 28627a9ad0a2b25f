// What splats, looked at in the pixel's centre, change in one of its layers. ps_layer: the light L that they send from before
// the layer, and what they hide of it, 1 - T. Each sub-sample that the pixel filter takes in counts to the layer of this pixel
// whose depth is nearest to its own: its weight gains L, and (1 - T) of what is opaque in it goes. Rows of ps_weights and texels
// of ps_members as in difference.frag, of all sub-samples. PS_BEHIND: what open sub-samples show. PS_PLACES: groups are not
// listed in the order of their pixels.

#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/translucent/place.glsl"

#define PS_LAYERS 5  // of a pixel: groups, and what is open

float ps_depth_of(ivec2 pixel, uvec2 codes, vec4 member)
{
  uint bits = texelFetch(ps_depths, ps_central_cell(pixel) + ivec2(member.yz), 0).x;
  return ps_group(codes, int(member.x)) == PS_NO_GROUP ? PS_BEHIND_ALL : uintBitsToFloat(bits) + u.near;
}

vec4 ps_opaque_in(ivec2 pixel, int first, uint group)
{
  if (group == PS_NO_GROUP) {
#ifdef PS_BEHIND
    return texelFetch(ps_behind, pixel, 0);
#else
    return vec4(0.0);
#endif
  }
  return texelFetch(ps_combined, ps_group_texel(first + int(group)), 0);
}

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy), last = textureSize(ps_first, 0) - 1;
  out_difference = vec4(0.0);
  vec2 place = texelFetch(ps_place, pixel, 0).xy;
  vec4 seen = texelFetch(ps_layer, pixel, 0);
  if (place.y < 0.0 || seen.w == 0.0) {
    discard;
  }

  // The depths of the pixel's other layers.
  float others[PS_LAYERS];
  int layers = 0;
  uvec2 own = uvec2(texelFetch(ps_first, pixel, 0).x, texelFetch(ps_second, pixel, 0).x);
  uint met = 1u << uint(place.y);
  for (int i = 0; i < ((own.y & PS_UNIFORM) != 0u ? 0 : u.sub_samples); i++) {
    vec4 member = texelFetch(ps_members, ivec2(i, 0), 0);
    uint group = ps_group(own, int(member.x));
    if ((met & (1u << group)) == 0u && layers < PS_LAYERS) {
      met |= 1u << group;
      others[layers] = ps_depth_of(pixel, own, member);
      layers++;
    }
  }

  float weights = 0.0;
  vec4 opaque = vec4(0.0);
  for (int row = 0; row < u.neighbours; row++) {
    ivec2 at = pixel + ivec2(texelFetch(ps_weights, ivec2(0, row), 0).x, texelFetch(ps_weights, ivec2(1, row), 0).x);
    at = clamp(at, ivec2(0), last);
    uvec2 codes = uvec2(texelFetch(ps_first, at, 0).x, texelFetch(ps_second, at, 0).x);
    int first = int(texelFetch(ps_starts, at, 0).x);
    bool whole = (codes.y & PS_UNIFORM) != 0u;
    for (int i = 0; i < (whole ? 1 : u.sub_samples); i++) {
      vec4 member = texelFetch(ps_members, ivec2(i, 0), 0);
      bool mine = true;
      if (layers > 0) {
        float depth = ps_depth_of(at, codes, member), mismatch = abs(depth - place.x);
        for (int k = 0; k < layers; k++) {
          mine = mine && mismatch <= abs(depth - others[k]);
        }
      }
      if (mine) {
        float weight = texelFetch(ps_weights, ivec2(whole ? 2 : 3 + i, row), 0).x;
        weights += weight;
        opaque += weight * ps_opaque_in(at, first, ps_group(codes, int(member.x)));
      }
    }
  }
  vec4 shown = seen;
#ifdef PS_HOLDOUT
  shown.w = max(shown.w - texelFetch(ps_cut, pixel, 0).y, 0.0);
#endif
  out_difference = weights * shown - seen.w * opaque;
}
