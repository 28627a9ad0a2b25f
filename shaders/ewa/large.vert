// Two triangles that hold what each large splat shows on the screen: its ellipse, or (PS_BLEND) its kernel. The splat's
// plane goes along, for fragments to meet. Layout: render/passes/ewa/ewa.py.

#include "lib/data/splat.glsl"
#include "lib/geometry/ellipsoid_bounds.glsl"
#include "lib/splat/ewa.glsl"
#include "lib/splat/ewa_varyings.glsl"

// Conjugate half-axes of the rim in view space; a ball's face the eye.
void ps_half_axes(ivec3 element, vec3 p, float normal_code, out vec3 a, out vec3 b)
{
  vec4 extent = texelFetch(ps_extent, element.xy, 0);
  mat3 linear = ps_linear(element.z);
  if (normal_code < 0.0) {
    vec3 ray = ps_is_perspective() ? normalize(p) : vec3(0.0, 0.0, -1.0);
    vec3 side = abs(ray.y) < 0.9 ? vec3(0.0, 1.0, 0.0) : vec3(1.0, 0.0, 0.0);
    a = extent.x * length(transpose(linear)[2]) * normalize(cross(ray, side));
    b = cross(ray, a);
    return;
  }
  vec3 n = ps_unpack_normal(normal_code);
  vec3 axis = cross(abs(n.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0), n);
#ifdef PS_ELLIPSES
  axis = extent.x > extent.y ? ps_unpack_normal(extent.z) : axis;
#endif
  axis = normalize(axis - dot(axis, n) * n);
  a = linear * (extent.x * axis);
  b = linear * (extent.y * cross(n, axis));
}

void main()
{
  int corner = gl_VertexID % 6;
  ivec2 at = ps_listed(u.first + gl_VertexID / 6);
  ps_splat(at, texelFetch(ps_splat_centre, at, 0));
  v_u = v_v = v_plane = vec4(0.0);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  ivec3 element = ps_element((at.y << PS_PAGE_SHIFT) + at.x);
  vec4 head = texelFetch(ps_position, element.xy, 0);
  vec3 p = ps_view_from_point(element.z, head.xyz), a, b;
  ps_half_axes(element, p, head.w, a, b);
  // Twice, since squares of areas are no floats where lengths are below 1e-9.
  float longer = max(length(a), length(b));
  vec3 plane = cross(a / longer, b / longer);
  float area = length(plane);
  if (!(area > 0.0)) {
    return;
  }
  plane /= area;
  area *= longer;
  // Of a point h of the plane, along_a . (h - p) and along_b . (h - p) are coordinates in which the rim is the unit circle.
  vec3 along_a = cross(b / longer, plane) / area, along_b = cross(plane, a / longer) / area;
  v_u = vec4(along_a, dot(along_a, p));
  v_v = vec4(along_b, dot(along_b, p));
  v_plane = vec4(plane, dot(plane, p));
#ifdef PS_BLEND
  float rim = 0.5 * PS_EWA_CUTOFF_SIGMA, margin = PS_EWA_CUTOFF_SIGMA * sqrt(u.low_pass) + 1.0;
#else
  float rim = 0.5 * sqrt(v_conic.w), margin = 1.0;
#endif
  mat3 spread = rim * rim * (outerProduct(a, a) + outerProduct(b, b));
  vec2 x = ps_ellipsoid_bounds(p, spread, 0) * u.focal.x + u.principal_point.x;
  vec2 y = ps_ellipsoid_bounds(p, spread, 1) * u.focal.y + u.principal_point.y;
  vec2 low = vec2(min(x.x, x.y), min(y.x, y.y)) - margin, high = vec2(max(x.x, x.y), max(y.x, y.y)) + margin;
  bool right = corner == 1 || corner == 2 || corner == 4, top = corner == 2 || corner >= 4;
  vec2 size = vec2(u.size);
  vec2 pixel = clamp(vec2(right ? high.x : low.x, top ? high.y : low.y), vec2(-1.0), size + 1.0);
  gl_Position = vec4(pixel / size * 2.0 - 1.0, 0.0, 1.0);
}
