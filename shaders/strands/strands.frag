// Segments of strands into the G-buffer that points and polygons share. Tubes are met by the pixels' rays. What is too
// narrow for its own normals keeps its tangent (PS_STRAND), which lib/strands/hair.glsl shades.

#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"
#include "lib/strands/segment.glsl"
#include "lib/strands/strand_attributes.glsl"

void main()
{
  PsSegment segment = PsSegment(ps_texel(int(v_segment.x)), ps_texel(int(v_segment.y)), int(v_segment.z), v_segment.w,
                                vec4(0.0));
#ifdef PS_TUBE
  PsTube tube = PsTube(v_from, v_to, v_begin, v_end);
  PsHit hit = ps_meet_tube(gl_FragCoord.xy, tube);
  float d = hit.d, along = hit.along;
#else
#ifdef PS_THIN
  // In the share of the samples that is the strand's of the line's width.
  if (fract(v_share.y + u.sample_offset) >= v_share.x) {
    discard;
  }
#endif
  float d = -v_position.z, along = v_along;
#endif
  if (!(d >= u.near && d <= u.far)) {
    discard;
  }
  PsSurfel s = ps_empty();
  s.centre = vec4(d, 0.0, 0.0, PS_POLYGON);
  s.shape.w = segment.material;
#ifdef PS_NORMAL
#ifdef PS_TUBE
  vec4 normal = ps_tube_normal(segment, tube, hit);
  s.normal.xyz = normal.xyz;
  s.centre.y = normal.w * PS_STRAND;
#else
  s.normal.xyz = normalize(v_normal);
#ifndef PS_RIBBON
  s.centre.y = PS_STRAND;
#endif
#endif
#endif
  ps_strand_attributes(s, segment, along);
  ps_store_front(s, true);
  gl_FragDepth = ps_buffer_depth(d);
}
