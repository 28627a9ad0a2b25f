// Attributes of the splats that stand for groups of sub-samples: one texel of the G-buffer. Colours, and the normals by
// which disks are shaded, are the mean over all sub-samples of the group.

#include "lib/visibility/splat.glsl"
#include "lib/visibility/leader.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"
#include "lib/data/attributes.glsl"
#ifdef PS_NORMAL
#include "lib/splat/lit_normal.glsl"
#endif
#ifdef PS_SPREAD
#include "lib/visibility/surface_key.glsl"
#include "lib/visibility/normal_spread.glsl"
#endif

#if defined(PS_NORMAL) && !defined(PS_ROUND) && !defined(PS_NODES)
#define PS_DISKS
#endif
#if (defined(PS_COLOR) || defined(PS_EMISSION) || defined(PS_DISKS)) && !defined(PS_CENTRAL)
#define PS_AVERAGE
#endif

#ifdef PS_DISKS
// The normal by which a disk is shaded, turned to the eye. `toward`: from the eye to the disk.
vec3 ps_disk_normal(ivec3 element, vec3 toward)
{
  mat3 linear = ps_linear(element.z);
  vec3 n = ps_view_normal(linear, ps_unpack_normal(ps_splat_head(element).w));
  bool turned = dot(n, toward) > 0.0;
  return ps_lit_normal(turned ? -n : n, element, linear, toward, turned);
}
#endif

#ifdef PS_AVERAGE
// Adds the attributes of the splat that a sub-sample shows, where it is one of this page.
void ps_add_attributes(inout PsSurfel sum, inout float count, ivec2 cell, vec3 toward)
{
  int index = int(texelFetch(ps_ids, cell, 0).x & 0x7FFFFFFFu) - u.first_index;
  ivec3 element = index >= 0 ? ps_element(index) : ivec3(-1);
  if (element.x >= 0) {
    PsSurfel s = ps_attributed(ps_empty(), element);
#ifdef PS_DISKS
    // Balls and disks may share a page, but no group: what balls add is not read.
    sum.normal.xyz += ps_disk_normal(element, toward);
#endif
#ifdef PS_COLOR
    sum.color += s.color;
#endif
#ifdef PS_SURFACE
    sum.normal.w += s.normal.w;
#endif
#ifdef PS_EMISSION
    sum.emission += s.emission;
#endif
    count += 1.0;
  }
}
#endif

void main()
{
  PsLeader leader = ps_leader(ivec2(gl_FragCoord.xy));
  int index = leader.index - u.first_index;
  ivec3 element = leader.index >= 0 && index >= 0 ? ps_element(index) : ivec3(-1);
  if (element.x < 0) {
    discard;
  }
  PsUnitSplat splat;
  ps_unit_splat(element, splat);
  vec2 cell = ps_cell_from_pixel(vec2(leader.pixel) + 0.5 + leader.offset);
  vec3 toward = ps_is_perspective() ? leader.position : vec3(0.0, 0.0, -1.0);
  PsSurfel s = ps_empty();
  s.centre = vec4(-leader.position.z, 0.0, 0.0, PS_POLYGON);
  s.shape = vec4(leader.offset, 0.0, floor(ps_splat_extent(element).w));
#ifdef PS_NORMAL
  vec3 own = ps_splat_normal(splat, ps_meet_splat(splat, cell - splat.centre), toward);
#if defined(PS_NODES)
  // Half as wide as it is, in pixels: the balls that it stands for rise above it.
  float wider = (splat.thinning > 0.0 ? PS_WIDER : 1.0) * float(PS_SUB_SAMPLES);
  s.centre.z = PS_BALL - 0.25 * length(splat.box.zw - splat.box.xy) * inversesqrt(wider);
#elif defined(PS_ROUND)
  s.centre.z = PS_BALL;
#endif
#if defined(PS_ROUND) || defined(PS_NODES)
  s.normal.xyz = own;
#else
  s.centre.z = splat.ball ? PS_BALL : 0.0;
  s.normal.xyz = splat.ball ? own : ps_disk_normal(element, toward);
#ifdef PS_SHADING_NORMAL
  s.centre.z = splat.ball ? PS_BALL : 1.0 + ps_pack_normal(own);
#endif
#endif
#endif
  s = ps_attributed(s, element);
#ifdef PS_SPREAD
  ps_shade_by_keys(s, leader.pixel, leader.layer);
#endif
#ifdef PS_AVERAGE
  uvec2 codes = uvec2(texelFetch(ps_first, leader.pixel, 0).x, texelFetch(ps_second, leader.pixel, 0).x);
  ivec2 middle = ps_central_cell(leader.pixel);
  PsSurfel sum = ps_empty();
  float count = 0.0;
  uvec2 members = ps_group_members(codes, uint(leader.layer));
  while ((members.x | members.y) != 0u) {
    ps_add_attributes(sum, count, middle + ps_next_member(members), toward);
  }
  if (count > 0.0) {
#ifdef PS_DISKS
    s.normal.xyz = splat.ball ? s.normal.xyz : ps_direction(sum.normal.xyz, s.normal.xyz);
#ifdef PS_SPREAD
    s.centre.y = splat.ball ? s.centre.y : ps_normal_spread(PsNormals(sum.normal.xyz, count, 0.0));
#endif
#endif
#ifdef PS_COLOR
    s.color = sum.color / count;
#endif
#ifdef PS_SURFACE
    s.normal.w = sum.normal.w / count;
#endif
#ifdef PS_EMISSION
    s.emission = sum.emission / count;
#endif
  }
#endif
  ps_store(s);
}
