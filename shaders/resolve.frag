// The splat that each pixel identified, with its ellipse projected: one texel of the G-buffer.

#include "lib/splat.glsl"
#include "lib/surfel.glsl"
#include "lib/store.glsl"

// A splat is at least this wide, as a standard deviation in pixels, in any direction: it then reaches its pixel's
// centre often enough for the pyramid to find no holes, and a silhouette grows by less than a third of a pixel.
#define PS_LEAST_SIGMA 0.15

void main()
{
  ivec2 place = ivec2(gl_FragCoord.xy);
  uint id = texelFetch(ps_ids, place, 0).x;
  int index = int(id - uint(frame.page.x));
  if (id == 0xFFFFFFFFu || id < uint(frame.page.x) || (index >> frame.page.z) >= frame.page.y) {
    discard;
  }
  ivec3 element = ps_element(index);
  vec4 head = texelFetch(ps_place, element.xy, 0);
  vec4 extent = texelFetch(ps_extent, element.xy, 0);
  mat3 linear = ps_linear(element.z);
  vec3 p = ps_view_from_point(element.z, head.xyz);
  vec3 pixel = ps_pixel_from_view(p);

  // Conjugate half-axes of the ellipse in view space; a ball faces the eye.
  vec3 a, b, normal = vec3(0.0);
  float radius;
  if (head.w >= 0.0) {
    vec3 n = ps_unpack_normal(head.w), u, v;
    ps_basis(n, u, v);
    if (extent.z != 0.0) {
      float c = cos(extent.z), s = sin(extent.z);
      vec3 turned = c * u + s * v;
      v = c * v - s * u;
      u = turned;
    }
    a = linear * (u * extent.x);
    b = linear * (v * extent.y);
    normal = ps_view_normal(linear, n);
    radius = max(length(a), length(b));
  }
  else {
    radius = extent.x * pow(abs(determinant(linear)), 1.0 / 3.0);
    vec3 toward = ps_is_perspective() ? normalize(-p) : vec3(0.0, 0.0, 1.0);
    ps_basis(toward, a, b);
    a *= radius;
    b *= radius;
  }

  // Perspective Jacobian (Zwicker et al. 2001) of the half-axes; the rim lies at 2 sigma.
  float scale = ps_is_perspective() ? 1.0 / pixel.z : 1.0;
  vec2 slope = ps_is_perspective() ? p.xy * scale : vec2(0.0);
  vec2 ja = 0.5 * scale * frame.focal.xy * (a.xy + slope * a.z);
  vec2 jb = 0.5 * scale * frame.focal.xy * (b.xy + slope * b.z);
  vec3 covariance = vec3(ja.x * ja.x + jb.x * jb.x, ja.x * ja.y + jb.x * jb.y, ja.y * ja.y + jb.y * jb.y);
  float mean = 0.5 * (covariance.x + covariance.z);
  float least = mean - length(vec2(0.5 * (covariance.x - covariance.z), covariance.y));
  covariance.xz += max(PS_LEAST_SIGMA * PS_LEAST_SIGMA - least, 0.0);

  // Where the surface is steep, neighbours of one surface are this far apart in depth.
  float steep = head.w >= 0.0 ? min(length(normal.xy) / max(abs(normal.z), 1e-3), 8.0) : 1.0;

  PsSurfel s = ps_empty();
  s.place = vec4(pixel.z, pixel.xy - (vec2(place) + 0.5), radius + steep * ps_pixel_size(pixel.z));
  s.shape = vec4(ps_cholesky(covariance), extent.w);
#ifdef PS_NORMAL
  s.normal.xyz = normal;
#ifdef PS_SHADING_NORMAL
  float code = texelFetch(ps_shading_normal, element.xy, 0).x;
  if (code >= 0.0) {
    s.normal.xyz = ps_view_normal(linear, ps_unpack_normal(code));
  }
#endif
#endif
#ifdef PS_COLOR
  s.color.rgb = texelFetch(ps_color, element.xy, 0).rgb;
#endif
#ifdef PS_SURFACE
  vec2 surface = texelFetch(ps_surface, element.xy, 0).xy;
  s.normal.w = surface.x;
  s.color.w = surface.y;
#endif
#ifdef PS_EMISSION
  s.emission = texelFetch(ps_emission, element.xy, 0);
#endif
#ifdef PS_OWNER
  s.owner = uint(element.z);
#endif
#ifdef PS_HOLDOUT
  if (ps_instance_row(element.z, 3).x > 0.5) {
    s.shape.w = -1.0 - s.shape.w;
  }
#endif
  ps_store_front(s, ps_mahalanobis(s.shape.xyz, s.place.yz) <= PS_RIM);
#ifdef PS_DEPTH
  gl_FragDepth = ps_buffer_depth(pixel.z);
#endif
}
