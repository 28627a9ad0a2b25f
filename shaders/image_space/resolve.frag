// The splat that each pixel identified, with its ellipse projected: one texel of the G-buffer.

#include "lib/geometry/footprint.glsl"
#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"
#include "lib/data/attributes.glsl"
#ifdef PS_NORMAL
#include "lib/splat/lit_normal.glsl"
#endif

void main()
{
  ivec2 texel = ivec2(gl_FragCoord.xy);
  uint found = texelFetch(ps_ids, texel, 0).x;
  uint id = found & ~PS_OFF_CENTRE;
  int index = int(id - uint(u.first_index));
  if (found == 0xFFFFFFFFu || id < uint(u.first_index) || (index >> u.block_shift) >= u.block_count) {
    discard;
  }
  ivec3 element = ps_element(index);
  vec4 head = texelFetch(ps_position, element.xy, 0);
  vec4 extent = texelFetch(ps_extent, element.xy, 0);
  vec3 p = ps_view_from_point(element.z, head.xyz);
  vec3 pixel = ps_pixel_from_view(p);
  vec3 covariance = ps_footprint(element.z, p, head.w, extent);
  mat3 linear = ps_linear(element.z);
  bool ball = head.w < 0.0;
  vec3 n = ball ? vec3(0.0) : ps_unpack_normal(head.w);
  vec3 normal = ball ? vec3(0.0) : ps_view_normal(linear, n);
  // Splats have two sides. Those that meet in a mean must show the same one.
  bool turned = dot(normal, ps_is_perspective() ? p : vec3(0.0, 0.0, -1.0)) > 0.0;
  normal = turned ? -normal : normal;

  // How far the splat extends in depth, and its neighbours on the same surface lie apart.
  vec3 depth_row = transpose(linear)[2];
  float along = dot(depth_row, n);
  float steep = ball ? 1.0 : min(length(normal.xy) / max(abs(normal.z), 1e-3), 1.0);
  float reach = extent.x * sqrt(max(dot(depth_row, depth_row) - along * along, 0.0)) + steep * ps_pixel_size(pixel.z);
  // Whether the splat holds the pixel's centre was found out when it was projected, in full precision.
  bool covers = found == id;

  PsSurfel s = ps_empty();
  s.centre = vec4(pixel.z, pixel.xy - (vec2(texel) + 0.5), covers ? max(reach, 1e-30) : -max(reach, 1e-30));
#ifdef PS_DISCONNECTED
  if (ps_alone(covariance, extent)) {
    s.centre = vec4(pixel.z, 0.0, 0.0, PS_POLYGON);
#ifdef PS_SHADING_NORMAL
    s.centre.z = ball ? 0.0 : 1.0 + ps_pack_normal(normal);
#endif
  }
#endif
  s.shape = vec4(ps_cholesky(covariance), floor(extent.w));
#ifdef PS_NORMAL
  s.normal.xyz = normal;
  s.normal.xyz = ps_lit_normal(s.normal.xyz, element, linear, ps_is_perspective() ? p : vec3(0.0, 0.0, -1.0), turned);
#endif
  s = ps_attributed(s, element);
  ps_store_front(s, covers);
#ifdef PS_DEPTH
  gl_FragDepth = covers ? ps_buffer_depth(pixel.z) : 1.0;  // what lies beside the centre hides no polygon
#endif
}
