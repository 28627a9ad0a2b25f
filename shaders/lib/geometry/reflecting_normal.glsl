// By which normal the eye is mirrored where normals are not those of the surface's plane.

// The normal, turned towards the surface's plane as far as it must be for the mirrored eye to lie above that: Cycles'
// ensure_valid_specular_reflection. `plane`: its normal, turned to the eye; (0, 0, 0): the normal's own plane.
vec3 ps_reflecting_normal(vec3 normal, vec3 plane, vec3 to_eye)
{
  float facing = dot(normal, to_eye);
  if (dot(plane, plane) < 0.5) {
    return facing < 0.0 ? -normal : normal;
  }
  float eye_z = dot(plane, to_eye), least = min(0.9 * eye_z, 0.01);
  vec3 across = normal - dot(normal, plane) * plane;
  float size = length(across);
  if (dot(plane, 2.0 * facing * normal - to_eye) >= least || size < 1e-6) {
    return normal;
  }
  across /= size;
  // Of the roots of 4 a z^4 - 2 b z^2 + c = 0, z the cosine to the plane's normal, the one that mirrors the eye to the side.
  float eye_x = dot(across, to_eye);
  float a = max(eye_x * eye_x + eye_z * eye_z, 1e-12), b = 2.0 * (a + eye_z * least);
  float c = (least + eye_z) * (least + eye_z), root = sqrt(max(b * b - 4.0 * a * c, 0.0));
  float z2 = clamp(0.25 * (b + (eye_x < 0.0 ? root : -root)) / a, 0.0, 1.0);
  return sqrt(1.0 - z2) * across + sqrt(z2) * plane;
}
