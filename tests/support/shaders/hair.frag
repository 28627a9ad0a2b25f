// Scatters one row of inputs: texel columns of `rows` are tangent, direction to the light and its spread, direction to
// the eye, and the
// material; what the surface reflects on the lower row, the rest above. FURNACE: radiance in a uniform world.
#include "lib/light/lights.glsl"
#include "lib/strands/hair.glsl"

void main() {
  int x = int(gl_FragCoord.x);
  vec4 base = texelFetch(rows, ivec2(x, 3), 0), rest = texelFetch(rows, ivec2(x, 4), 0);
  PsSurface surface = PsSurface(base.rgb, vec3(0.0), base.a, rest.x, rest.y);
  vec3 tangent = texelFetch(rows, ivec2(x, 0), 0).xyz, to_eye = texelFetch(rows, ivec2(x, 2), 0).xyz;
  vec4 fibre = texelFetch(rows, ivec2(x, 5), 0);
#ifdef FURNACE
  color = vec4(ps_shade_strand(vec3(0.0), tangent, to_eye, surface, fibre, 0), 1.0);
#else
  vec3 reflected, inner;
  vec4 direction = texelFetch(rows, ivec2(x, 1), 0);
  ps_scattered(ps_strand(surface, fibre, tangent, to_eye), direction.xyz, direction.w, reflected, inner);
  color = vec4(gl_FragCoord.y < 1.0 ? reflected : inner, 1.0);
#endif
}
