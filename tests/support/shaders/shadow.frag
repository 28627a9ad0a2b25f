// Transmittance of one row of receivers: texel columns of `rows` are position and normal in view space.
#include "lib/shadow/shadow.glsl"

void main()
{
  int x = int(gl_FragCoord.x);
  vec3 position = texelFetch(rows, ivec2(x, 0), 0).xyz, normal = texelFetch(rows, ivec2(x, 1), 0).xyz;
  color = vec4(ps_transmittance(LIGHT, position, normal, true), 1.0);
}
