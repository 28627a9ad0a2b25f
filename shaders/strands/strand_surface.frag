// Attributes of the segments of strands that stand for groups of sub-samples: one texel of the G-buffer. What several thin
// strands show is the mean over all sub-samples of the group.

#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/visibility/lattice.glsl"
#include "lib/visibility/leader.glsl"
#include "lib/strands/segment.glsl"
#include "lib/strands/strand_attributes.glsl"
#include "lib/visibility/surface_key.glsl"

#if !defined(PS_TUBE) && !defined(PS_CENTRAL)
#if defined(PS_COLOR) || defined(PS_EMISSION)
#define PS_AVERAGE
#endif
#if defined(PS_NORMAL) && !defined(PS_RIBBON)
#define PS_AVERAGE_TANGENT
#endif
#endif

PsSegment ps_listed_segment(int entry)
{
  return ps_segment(ivec2(texelFetch(ps_segment_list, ps_texel(entry), 0).xy));
}

// How far along a segment a point of it lies: 0 at its first end, 1 at its second.
float ps_along(PsSegment segment, vec3 position)
{
  vec3 from = ps_view_from_point(segment.instance, texelFetch(ps_point, segment.from, 0).xyz);
  vec3 chord = ps_view_from_point(segment.instance, texelFetch(ps_point, segment.to, 0).xyz) - from;
  return clamp(dot(position - from, chord) / max(dot(chord, chord), 1e-37), 0.0, 1.0);
}

#ifdef PS_AVERAGE
// Adds the attributes of the segment that a sub-sample shows, where it is one of these.
void ps_add_attributes(inout PsSurfel sum, inout float count, ivec2 cell)
{
  uint id = texelFetch(ps_ids, cell, 0).x;
  int entry = int(id & 0x7FFFFFFFu) - u.first_id;
  if ((id & PS_RASTERISED) != 0u && entry >= 0 && entry < u.count) {
    float d = uintBitsToFloat(texelFetch(ps_depths, cell, 0).x) + u.near;
    PsSegment segment = ps_listed_segment(entry);
    PsSurfel s = ps_empty();
    ps_strand_attributes(s, segment, ps_along(segment, ps_view_from_pixel(ps_pixel_from_cell(vec2(cell) + 0.5), d)));
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
  int entry = leader.index - u.first_id;
  if (!leader.rasterised || entry < 0 || entry >= u.count) {
    discard;
  }
  PsSegment segment = ps_listed_segment(entry);
  PsSurfel s = ps_empty();
  s.centre = vec4(-leader.position.z, 0.0, 0.0, PS_POLYGON);
  s.shape = vec4(leader.offset, 0.0, segment.material);
#ifdef PS_TUBE
  PsTube tube = ps_tube(segment);
  PsHit hit = ps_meet_tube(vec2(leader.pixel) + 0.5 + leader.offset, tube);
  float along = hit.along;
#ifdef PS_NORMAL
  vec4 normal = ps_tube_normal(segment, tube, hit);
  s.normal.xyz = normal.xyz;
  s.centre.y = normal.w * PS_STRAND;
#endif
#else
  float along = ps_along(segment, leader.position);
#ifdef PS_NORMAL
  mat3 linear = ps_linear(segment.instance);
  vec3 direction = linear * mix(texelFetch(ps_tangent, segment.from, 0).xyz,
                                texelFetch(ps_tangent, segment.to, 0).xyz, along);
#ifdef PS_RIBBON
  // Normal and tangent make the plane of a ribbon; the matrix turns both, so that sheared ones stay in theirs.
  direction = cross(direction, linear * mix(texelFetch(ps_side, segment.from, 0).xyz,
                                            texelFetch(ps_side, segment.to, 0).xyz, along));
#else
  s.centre.y = PS_STRAND;
#endif
  s.normal.xyz = ps_direction(direction, vec3(0.0, 0.0, 1.0));
#endif
#endif
#ifdef PS_NORMAL
  s.centre.z = ps_is_strand(s.centre) ? -texelFetch(ps_tangent, segment.from, 0).w / PS_STRAND_NUMBERS : 0.0;
#endif
  ps_strand_attributes(s, segment, along);
#if defined(PS_AVERAGE) || defined(PS_AVERAGE_TANGENT)
  uvec2 codes = uvec2(texelFetch(ps_first, leader.pixel, 0).x, texelFetch(ps_second, leader.pixel, 0).x);
  ivec2 middle = ps_central_cell(leader.pixel);
  PsSurfel sum = ps_empty();
  float count = 0.0;
  uvec2 members = ps_group_members(codes, uint(leader.layer));
  while ((members.x | members.y) != 0u) {
    ivec2 cell = middle + ps_next_member(members);
#ifdef PS_AVERAGE
    ps_add_attributes(sum, count, cell);
#endif
#ifdef PS_AVERAGE_TANGENT
    sum.normal.xyz += ps_key_normal(texelFetch(ps_keys, cell, 0).x);
#endif
  }
#ifdef PS_AVERAGE_TANGENT
  s.normal.xyz = ps_direction(sum.normal.xyz, s.normal.xyz);
#endif
#ifdef PS_AVERAGE
  if (count > 0.0) {
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
#endif
  ps_store(s);
}
