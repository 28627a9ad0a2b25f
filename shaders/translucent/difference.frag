// What translucent splats change in a layer of the pixel and of its neighbours, by the weights of the pixel filter. Rows of
// ps_weights, one for each neighbour of which something counts: its place (x, y), the weight of all of the sub-samples, and of
// each of them. Texels of ps_members: which sub-samples these are.

#include "lib/visibility/groups.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy), last = textureSize(ps_layer, 0) - 1;
  out_difference = vec4(0.0);
  for (int row = 0; row < u.neighbours; row++) {
    ivec2 at = pixel + ivec2(texelFetch(ps_weights, ivec2(0, row), 0).x, texelFetch(ps_weights, ivec2(1, row), 0).x);
    at = clamp(at, ivec2(0), last);
    uvec2 codes = uvec2(texelFetch(ps_first, at, 0).x, texelFetch(ps_second, at, 0).x);
    float group = texelFetch(ps_place, at, 0).y;
    bool whole = (codes.y & PS_UNIFORM) != 0u;
    float weight = whole && group >= 0.0 ? texelFetch(ps_weights, ivec2(2, row), 0).x : 0.0;
    for (int i = 0; i < (whole || group < 0.0 ? 0 : u.sub_samples); i++) {
      bool mine = ps_group(codes, int(texelFetch(ps_members, ivec2(i, 0), 0).x)) == uint(group);
      weight += mine ? texelFetch(ps_weights, ivec2(3 + i, row), 0).x : 0.0;
    }
    vec4 shown = texelFetch(ps_layer, at, 0);
#ifdef PS_HOLDOUT
    shown.w = max(shown.w - texelFetch(ps_cut, at, 0).y, 0.0);
#endif
    out_difference += weight * (shown - texelFetch(ps_opaque, at, 0));
  }
}
