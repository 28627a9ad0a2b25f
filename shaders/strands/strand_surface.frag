// Attributes of the segment of a strand that stands for a group of sub-samples: one texel of the G-buffer.

#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"
#include "lib/visibility/leader.glsl"
#include "lib/visibility/segment.glsl"
#include "lib/visibility/strand_attributes.glsl"

void main()
{
  PsLeader leader = ps_leader(ivec2(gl_FragCoord.xy));
  int entry = leader.index - u.first_id;
  if (!leader.rasterised || entry < 0 || entry >= u.count) {
    discard;
  }
  PsSegment segment = ps_segment(ivec2(texelFetch(ps_list, ps_texel(entry), 0).xy));
  PsSurfel s = ps_empty();
  s.centre = vec4(-leader.position.z, 0.0, 0.0, PS_POLYGON);
  s.shape = vec4(leader.offset, 0.0, segment.material);
#ifdef PS_TUBE
  PsTube tube = ps_tube(segment);
  PsHit hit = ps_meet_tube(gl_FragCoord.xy + leader.offset, tube);
  float along = hit.along;
#ifdef PS_NORMAL
  vec4 normal = ps_tube_normal(segment, tube, hit);
  s.normal.xyz = normal.xyz;
  s.centre.y = normal.w * PS_STRAND;
#endif
#else
  vec3 from = ps_view_from_point(segment.instance, texelFetch(ps_point, segment.from, 0).xyz);
  vec3 chord = ps_view_from_point(segment.instance, texelFetch(ps_point, segment.to, 0).xyz) - from;
  float along = clamp(dot(leader.position - from, chord) / max(dot(chord, chord), 1e-37), 0.0, 1.0);
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
  ps_strand_attributes(s, segment, along);
  ps_store(s);
}
