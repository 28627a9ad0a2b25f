// Directions packed into 24 bits of a float (integers that float32 holds exactly). Reference: render/packing.py.

#define PS_OCT_STEPS 4095.0

vec3 ps_unpack_normal(float code)
{
  float y = floor(code / 4096.0);
  vec2 e = vec2(code - 4096.0 * y, y) / PS_OCT_STEPS * 2.0 - 1.0;
  vec3 n = vec3(e, 1.0 - abs(e.x) - abs(e.y));
  if (n.z < 0.0) {
    n.xy = (1.0 - abs(n.yx)) * vec2(n.x >= 0.0 ? 1.0 : -1.0, n.y >= 0.0 ? 1.0 : -1.0);
  }
  return normalize(n);
}
