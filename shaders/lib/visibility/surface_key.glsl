// What tells surfaces apart when sub-samples are grouped: a number for instance and material, and the normal, 8 bits an axis;
// of fibres, which are strands that are shaded as a whole, the tangent.

#define PS_KEY_STEPS 255.0
#define PS_FIBRE_KEY 0x80000000u  // a bit of keys
#define PS_RASTERISED 0x80000000u  // of a primitive's number: the hardware has rasterised it

uint ps_surface_key(int instance, int material, vec3 normal)
{
  float size = abs(normal.x) + abs(normal.y) + abs(normal.z);
  vec3 n = normal / max(size, 1e-30);
  vec2 e = n.z >= 0.0 ? n.xy : (1.0 - abs(n.yx)) * vec2(n.x >= 0.0 ? 1.0 : -1.0, n.y >= 0.0 ? 1.0 : -1.0);
  uvec2 steps = uvec2((0.5 * e + 0.5) * PS_KEY_STEPS + 0.5);
  uint surface = (uint(instance) * 40503u + uint(material) * 257u) & 0x7FFFu;
  return (surface << 16u) | (min(steps.x, 255u) << 8u) | min(steps.y, 255u);
}

vec3 ps_key_normal(uint key)
{
  vec2 e = vec2((key >> 8u) & 255u, key & 255u) / PS_KEY_STEPS * 2.0 - 1.0;
  vec3 n = vec3(e, 1.0 - abs(e.x) - abs(e.y));
  if (n.z < 0.0) {
    n.xy = (1.0 - abs(n.yx)) * vec2(n.x >= 0.0 ? 1.0 : -1.0, n.y >= 0.0 ? 1.0 : -1.0);
  }
  return normalize(n);
}
