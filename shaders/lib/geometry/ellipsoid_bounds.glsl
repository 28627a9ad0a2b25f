// The bounds of an ellipsoid on the screen.

// Where planes through the eye and the picture's y axis (`axis` 0; x axis: 1) touch the ellipsoid with the centre p and
// the shape S = r^2 L L^T: those with (n . p)^2 = n^T S n. Slopes, or positions in a parallel view; everything where it reaches the
// eye.
vec2 ps_ellipsoid_bounds(vec3 p, mat3 shape, int axis)
{
  if (!ps_is_perspective()) {
    float half_width = sqrt(shape[axis][axis]);
    return vec2(p[axis] - half_width, p[axis] + half_width);
  }
  // In units of the depth, for fourth powers of lengths are no floats from 1e-9 and 1e9 on.
  float unit = 1.0 / max(abs(p.z), sqrt(shape[2][2]));
  p *= unit;
  shape *= unit * unit;
  float a = p.z * p.z - shape[2][2];
  float b = p[axis] * p.z - shape[axis][2];
  float c = p[axis] * p[axis] - shape[axis][axis];
  float root = sqrt(max(b * b - a * c, 0.0));
  return a > 1e-6 * p.z * p.z ? vec2(-b - root, -b + root) / a : vec2(-1e8, 1e8);
}
