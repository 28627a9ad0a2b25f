// The bounds of an ellipsoid on the screen.

// The ends of an ellipsoid that the plane through the eye, across the view, cuts. What is before that plane lies between one
// of the tangents and the plane itself, on the side where the plane cuts it; everything where the eye is inside. Arguments as
// those of ps_ellipsoid_ends.
vec2 ps_ends_beside_eye(float across, float across_across, float across_deep, float z, float deep_deep)
{
  float a = min(z * z / deep_deep - 1.0, -1e-6), b = (across * z - across_deep) / deep_deep;
  float c = (across * across - across_across) / deep_deep, square = b * b - a * c;
  if (!(square > 0.0 && square < 1e37)) {
    return vec2(-1e8, 1e8);
  }
  float root = sqrt(square), q = -(b + (b < 0.0 ? -root : root));
  float one = q / a, other = c / q;
  return across - across_deep / deep_deep * z > 0.0 ? vec2(max(one, other), 1e8) : vec2(-1e8, min(one, other));
}

// Where planes through the eye and the picture's y axis (`axis` 0; x axis: 1) touch the ellipsoid with the centre p and
// the shape S = r^2 L L^T: those with (n . p)^2 = n^T S n. Slopes, or positions in a parallel view.
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
  if (a > 1e-6 * p.z * p.z) {
    return vec2(-b - root, -b + root) / a;
  }
  return ps_ends_beside_eye(p[axis], shape[axis][axis], shape[axis][2], p.z, shape[2][2]);
}

// The same along any axis of the picture, given the products of the centre p and of the shape S with it: across = a . p,
// a . S a, and the component along z of S a; and z and S_zz. The root is taken of what is left once the large terms have
// cancelled, so that splats much smaller than a pixel keep their size.
vec2 ps_ellipsoid_ends(float across, float across_across, float across_deep, float z, float deep_deep)
{
  if (!ps_is_perspective()) {
    float half_width = sqrt(across_across);
    return vec2(across - half_width, across + half_width);
  }
  float a = 1.0 - deep_deep / (z * z);
  float b = across / z - across_deep / (z * z);
  float slope = across / z;
  float square = (across_across - slope * (2.0 * across_deep - slope * deep_deep)) / (z * z) +
                 (across_deep / (z * z)) * (across_deep / (z * z)) - (deep_deep / (z * z)) * (across_across / (z * z));
  float root = sqrt(max(square, 0.0));
  return a > 1e-6 ? vec2(-b - root, -b + root) / a : ps_ends_beside_eye(across, across_across, across_deep, z, deep_deep);
}
