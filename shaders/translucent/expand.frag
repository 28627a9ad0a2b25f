// One of the opaque layers that some of a pixel's sub-samples show, twice: one is blended over, and the other tells what that
// changes. Layers are groups, in the order in which these sub-samples meet them; what is open is one, too. out_place: the
// layer's depth, and its group. Texels of ps_members: which sub-samples, and the cells where they lie. PS_BEHIND: what open
// sub-samples show. PS_PLACES: groups are not listed in the order of their pixels.
// PS_MATTES: out_place also holds what shadows leave of the light on mattes, -1 for other layers. PS_EMPTY:
// blending begins with nothing, and what is opaque is told elsewhere. PS_APART: what is open is none of these layers, but
// the layer -1.

#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/translucent/place.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  uvec2 codes = uvec2(texelFetch(ps_first, pixel, 0).x, texelFetch(ps_second, pixel, 0).x);
  int count = (codes.y & PS_UNIFORM) != 0u ? 1 : u.sub_samples, layer = -1;
  uint seen = 0u, group = PS_NO_GROUP;
  ivec2 cell = ivec2(0);
  for (int i = 0; i < count && layer < u.layer; i++) {
    vec4 member = texelFetch(ps_members, ivec2(i, 0), 0);
    group = ps_group(codes, int(member.x));
#ifdef PS_APART
    layer += group == PS_NO_GROUP || (seen & (1u << group)) != 0u ? 0 : 1;
#else
    layer += (seen & (1u << group)) == 0u ? 1 : 0;
#endif
    seen |= 1u << group;
    cell = ivec2(member.yz);
  }
#ifdef PS_APART
  bool open = u.layer < 0, there = open ? (codes.y & PS_OPEN) != 0u : layer == u.layer;
  group = open ? PS_NO_GROUP : group;
#else
  bool there = layer == u.layer, open = group == PS_NO_GROUP;
#endif
  uint bits = texelFetch(ps_depths, ps_central_cell(pixel) + cell, 0).x;
  float depth = open ? PS_BEHIND_ALL : uintBitsToFloat(bits) + u.near;
  out_place = there ? vec4(depth, float(group), 0.0, 0.0) : vec4(PS_NOWHERE, -1.0, 0.0, 0.0);
#ifdef PS_MATTES
  vec4 matte = vec4(0.0);
  if (there && !open) {
    matte = texelFetch(ps_matte, ps_group_texel(int(texelFetch(ps_starts, pixel, 0).x) + int(group)), 0);
  }
  out_place.z = matte.a > 0.5 ? dot(matte.rgb, vec3(1.0 / 3.0)) : -1.0;
#endif
#ifdef PS_EMPTY
  out_layer = vec4(0.0);
#else
  int entry = int(texelFetch(ps_starts, pixel, 0).x) + (open ? 0 : int(group));
  vec4 shown = open ? vec4(0.0) : texelFetch(ps_combined, ps_group_texel(entry), 0);
#ifdef PS_BEHIND
  shown = open ? texelFetch(ps_behind, pixel, 0) : shown;
#endif
  out_layer = shown;
  out_opaque = shown;
#endif
}
