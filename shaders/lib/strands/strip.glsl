// Strips: two triangles along a segment.

#include "lib/geometry/camera.glsl"

// One of the six corners of a strip between the points p, whose edges lie `sides` from them, all in view space; `along`: 0
// at the first point, 1 at the second.
vec3 ps_strip_corner(int corner, vec3 p[2], vec3 sides[2], out float along)
{
  int end = corner == 1 || corner == 2 || corner == 4 ? 1 : 0;
  along = float(end);
  float right = corner == 2 || corner == 4 || corner == 5 ? 1.0 : -1.0;
  vec3 position = p[end] + right * sides[end];
  // Where a ribbon turns its other side to the eye, its edges cross: there are two triangles with one tip in common, for
  // two that make a quad would hide that it is edge on between them. Sides are seen with the axis: their sense is that of
  // the plane through the eye and the axis.
  vec3 plane = cross(p[1] - p[0], ps_is_perspective() ? p[0] : vec3(0.0, 0.0, -1.0));
  float seen = dot(sides[0], plane), other = dot(sides[1], plane);
  if (sign(seen) * sign(other) < 0.0) {
    along = corner == 2 || corner == 4 ? seen / (seen - other) : along;
    if (corner == 2 || corner == 4) {
      position = mix(p[0], p[1], along);
    } else if (corner < 3) {
      along = 0.0;
      position = p[0] + (corner == 0 ? -1.0 : 1.0) * sides[0];
    } else {
      along = 1.0;
      position = p[1] + (corner == 3 ? -1.0 : 1.0) * sides[1];
    }
  }
  return position;
}
