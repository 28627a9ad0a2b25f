// Directions packed into 24 bits of a float (integers that float32 holds exactly). Reference: render/device/packing.py.

#define PS_OCT_STEPS 4095.0
#define PS_FACET_STEPS 511.0

vec3 ps_unpack_octahedral(float code, float steps)
{
  float y = floor(code / (steps + 1.0));
  vec2 e = vec2(code - (steps + 1.0) * y, y) / steps * 2.0 - 1.0;
  vec3 n = vec3(e, 1.0 - abs(e.x) - abs(e.y));
  if (n.z < 0.0) {
    n.xy = (1.0 - abs(n.yx)) * vec2(n.x >= 0.0 ? 1.0 : -1.0, n.y >= 0.0 ? 1.0 : -1.0);
  }
  return normalize(n);
}

vec3 ps_unpack_normal(float code)
{
  return ps_unpack_octahedral(code, PS_OCT_STEPS);
}

float ps_pack_normal(vec3 n)
{
  vec3 m = n / max(abs(n.x) + abs(n.y) + abs(n.z), 1e-30);
  vec2 e = m.z >= 0.0 ? m.xy : (1.0 - abs(m.yx)) * vec2(m.x >= 0.0 ? 1.0 : -1.0, m.y >= 0.0 ? 1.0 : -1.0);
  vec2 steps = clamp(floor((0.5 * e + 0.5) * PS_OCT_STEPS + 0.5), vec2(0.0), vec2(PS_OCT_STEPS));
  return steps.x + (PS_OCT_STEPS + 1.0) * steps.y;
}

// A normal and its share in 63rds.
vec4 ps_unpack_facet(float code)
{
  float share = floor(code / 262144.0);
  return vec4(ps_unpack_octahedral(code - 262144.0 * share, PS_FACET_STEPS), share);
}
