// Shades one row of inputs: texel columns of `rows` are position, normal, direction to the eye, and the surface with its plane.
#include "lib/light/lights.glsl"

void main() {
  int x = int(gl_FragCoord.x);
  vec4 base = texelFetch(rows, ivec2(x, 3), 0);
  vec4 emission = texelFetch(rows, ivec2(x, 4), 0);
  vec4 rest = texelFetch(rows, ivec2(x, 5), 0);
#ifdef PS_SPREAD
  PsSurface surface = PsSurface(base.rgb, emission.rgb, base.a, emission.a, rest.x, texelFetch(rows, ivec2(x, 0), 0).a);
#else
  PsSurface surface = PsSurface(base.rgb, emission.rgb, base.a, emission.a, rest.x);
#endif
  vec3 radiance = ps_shade(texelFetch(rows, ivec2(x, 0), 0).xyz, texelFetch(rows, ivec2(x, 1), 0).xyz,
                           rest.yzw, texelFetch(rows, ivec2(x, 2), 0).xyz, surface, LIGHTS);
  color = vec4(radiance, 1.0);
}
