// Segments of strands, from pages of control points and the list of what a view draws. Layout:
// render/passes/strands/strand_page.py.

#include "lib/geometry/instance.glsl"
#include "lib/strands/tube.glsl"

#define PS_LEAST_SINE 0.1  // between a strand and a ray of light: what is turned to it more closely is treated as this

struct PsSegment {
  ivec2 from, to;  // texels of the points at both ends
  int instance;
  float material;  // -1 - m: a holdout
  vec4 rest;  // of strips the share of the raster line's width at both ends, phase; of tubes the ends of the strand
};

PsSegment ps_segment(ivec2 at)
{
  vec4 row = texelFetch(ps_segments, at, 0);
  return PsSegment(ps_texel(int(row.x)), ps_texel(int(row.y)), int(row.z), row.w,
                   texelFetch(ps_segments, at + ivec2(1, 0), 0));
}

#ifdef PS_TUBE
// The plane in which a strand ends: what is kept has dot(plane.xyz, p) + plane.w >= 0.
vec4 ps_end_plane(int instance, float point, float sense)
{
  if (point < 0.0) {
    return vec4(0.0, 0.0, 0.0, 1.0);
  }
  ivec2 at = ps_texel(int(point));
  vec3 inward = sense * normalize(ps_linear(instance) * texelFetch(ps_tangent, at, 0).xyz);
  return vec4(inward, -dot(inward, ps_view_from_point(instance, texelFetch(ps_point, at, 0).xyz)));
}

PsTube ps_tube(PsSegment segment)
{
  float scale = ps_instance_row(segment.instance, 3).y;
  vec4 from = texelFetch(ps_point, segment.from, 0), to = texelFetch(ps_point, segment.to, 0);
  PsTube tube;
  tube.from = vec4(ps_view_from_point(segment.instance, from.xyz), scale * from.w);
  tube.to = vec4(ps_view_from_point(segment.instance, to.xyz), scale * to.w);
  tube.begin = ps_end_plane(segment.instance, segment.rest.x, 1.0);
  tube.end = ps_end_plane(segment.instance, segment.rest.y, -1.0);
  return tube;
}

#ifdef PS_NORMAL
#define PS_FIBRE_PIXELS 2.0  // of width: what is narrower is shaded as a whole

// The normal where a ray meets a tube; w: 0. What is too narrow for normals of its own, and hair, has its tangent; w: 1.
vec4 ps_tube_normal(PsSegment segment, PsTube tube, PsHit hit)
{
  mat3 linear = ps_linear(segment.instance);
  vec3 tangent = normalize(linear * mix(texelFetch(ps_tangent, segment.from, 0).xyz,
                                        texelFetch(ps_tangent, segment.to, 0).xyz, hit.along));
  float width = 2.0 * mix(tube.from.w, tube.to.w, hit.along) / ps_pixel_size(hit.d);
  int material = int(segment.material < -0.5 ? -1.0 - segment.material : segment.material);
  bool fibre = width < PS_FIBRE_PIXELS || texelFetch(ps_materials, ivec2(3, material), 0).x > 0.5;
  // Round along the strand as well: across its own tangent, not the segment's.
  vec3 outward = hit.along > 0.0 && hit.along < 1.0 ? hit.normal - dot(hit.normal, tangent) * tangent : hit.normal;
  return fibre ? vec4(tangent, 1.0) : vec4(normalize(outward), 0.0);
}
#endif
#endif
