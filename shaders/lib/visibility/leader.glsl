// The sub-sample that stands for a group: which primitive it shows, and where. Textures: shaders/grouping/leader.frag.

#include "lib/geometry/camera.glsl"
#include "lib/visibility/listed.glsl"

struct PsLeader {
  bool rasterised;  // by the hardware; else by a compute shader
  int index;  // of the primitive among all that are drawn in that way; -1: there is no group
  ivec2 texel;  // of textures of all leaders
  ivec2 pixel;
  int layer;  // of the group among those of the pixel
  vec2 offset;  // pixels from the pixel's centre
  vec3 position;  // in view space
};

PsLeader ps_leader(ivec2 texel)
{
  const vec2 offsets[PS_SUB_SAMPLES] = PS_OFFSETS;
  PsListed listed = ps_listed(texel);
#ifdef PS_CENTRAL
  texel = listed.pixel;
#endif
  uint id = texelFetch(ps_leaders, texel, 0).x;
  PsLeader found;
  found.rasterised = (id & 0x80000000u) != 0u;
  found.index = id == 0xFFFFFFFFu ? -1 : int(id & 0x7FFFFFFFu);
  found.texel = texel;
  found.pixel = listed.pixel;
  found.layer = listed.layer;
  found.offset = offsets[int(texelFetch(ps_members, texel, 0).x)];
  float d = uintBitsToFloat(texelFetch(ps_leader_depths, texel, 0).x) + u.near;
  found.position = ps_view_from_pixel(vec2(listed.pixel) + 0.5 + found.offset, d);
  return found;
}
