// By which normal the eye is mirrored, and light gathered, where normals are not those of the surface's plane.

#define PS_BENT 0.6  // cosine between them, below which what lies below the plane does not count,
#define PS_ROUND_ENOUGH 0.8  // and above which it does

// What a surface gathers by whose normal is far from its plane's: light from below the plane, which would come through the surface, does
// not count. The lobe around the normal, less what lies below, has its mean along a direction, xyz. Of an even light it has w times
// what the lobe around that direction has, less what lies below.
// `plane`: its normal, either way.
vec4 ps_gathering_normal(vec3 normal, vec3 plane, vec3 to_eye)
{
  plane = dot(plane, to_eye) < 0.0 ? -plane : plane;
  float cosine = clamp(dot(normal, plane), -1.0, 1.0), angle = acos(cosine);
  vec3 cut = normalize((3.14159265 - angle) * normal + sin(angle) * plane + 1e-6 * to_eye);
  // Smooth normals of coarse triangles stand for a surface that is round.
  float bent = 1.0 - smoothstep(PS_BENT, PS_ROUND_ENOUGH, cosine);
  vec3 toward = normalize(mix(normal, cut, bent));
  return vec4(toward, mix(1.0, (1.0 + cosine) / (1.0 + max(dot(toward, plane), 0.0)), bent));
}

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
