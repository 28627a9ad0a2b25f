// Balls that are wide on the screen: a rectangle around each one's picture.

#include "lib/data/splat.glsl"
#include "lib/geometry/ellipsoid_bounds.glsl"

void main()
{
  int index = gl_VertexID / 6, corner = gl_VertexID - 6 * index;
  v_centre = vec3(0.0);
  v_row0 = v_row1 = v_row2 = vec3(0.0);
  v_element = vec3(-1.0);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  ivec3 element = ps_element(index);
  if (element.x < 0) {
    return;
  }
  vec3 p = ps_view_from_point(element.z, texelFetch(ps_position, element.xy, 0).xyz);
  float radius = texelFetch(ps_extent, element.xy, 0).x;
  mat3 linear = ps_linear(element.z);
  // Where the ellipsoid is the unit ball: the inverse of r L, by cofactors.
  mat3 cofactors = mat3(cross(linear[1], linear[2]), cross(linear[2], linear[0]), cross(linear[0], linear[1]));
  float volume = dot(linear[0], cofactors[0]) * radius;
  mat3 shape = (radius * linear) * transpose(radius * linear);
  float deep = sqrt(shape[2][2]);
  if (abs(volume) < 1e-37 || -p.z + deep < u.near || -p.z - deep > u.far) {
    return;
  }
  v_centre = p;
  v_row0 = cofactors[0] / volume;
  v_row1 = cofactors[1] / volume;
  v_row2 = cofactors[2] / volume;
  v_element = vec3(element);
  vec2 x = ps_ellipsoid_bounds(p, shape, 0) * u.focal.x + u.principal_point.x;
  vec2 y = ps_ellipsoid_bounds(p, shape, 1) * u.focal.y + u.principal_point.y;
  ivec2 side = ivec2(corner == 1 || corner == 2 || corner == 4, corner == 2 || corner == 4 || corner == 5);
  vec2 size = vec2(u.size);
  vec2 pixel = clamp(vec2(side.x == 0 ? min(x.x, x.y) : max(x.x, x.y), side.y == 0 ? min(y.x, y.y) : max(y.x, y.y)),
                     vec2(-1.0), size + 1.0);
  gl_Position = vec4(pixel / size * 2.0 - 1.0, 0.0, 1.0);
}
