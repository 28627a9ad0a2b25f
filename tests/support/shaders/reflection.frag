// Shades one row of surfaces below a sun: texel columns of `rows` are normal, direction to the eye, base colour and roughness,
// metallic and relative index, tangent. What is alike for all of them are defines.
#include "lib/light/lights.glsl"

void main() {
  int x = int(gl_FragCoord.x);
  vec4 base = texelFetch(rows, ivec2(x, 2), 0), rest = texelFetch(rows, ivec2(x, 3), 0);
#ifdef PS_TINTED
  ps_tint = TINT;
#endif
#ifdef PS_GLOSS
  ps_gloss = GLOSS;
#endif
#ifdef PS_ROUGH_DIFFUSE
  ps_diffuse_roughness = DIFFUSE_ROUGHNESS;
#endif
#ifdef PS_SHEEN
  ps_sheen = SHEEN;
#endif
#ifdef PS_TOON
  ps_toon = vec3(TOON, 1.0);
#endif
#ifdef PS_TANGENT
  ps_grain = texelFetch(rows, ivec2(x, 4), 0).xyz;
#endif
  PsSurface surface = PsSurface(base.rgb, vec3(0.0), base.a, rest.x, rest.y);
  color = vec4(ps_shade(vec3(0.0), texelFetch(rows, ivec2(x, 0), 0).xyz, vec3(0.0), texelFetch(rows, ivec2(x, 1), 0).xyz,
                        surface, LIGHTS), 1.0);
}
