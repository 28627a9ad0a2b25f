// Normals and heights in pictures over footprints: of each column of `rows` UV, and the sides of a parallelogram in UV.

#include "lib/data/polygon.glsl"

void main()
{
  ivec2 first = ivec2(int(gl_FragCoord.x), 0);
  vec2 uv = texelFetch(rows, first, 0).xy;
  vec4 sides = texelFetch(rows, first + ivec2(0, 1), 0);
  PsFootprint footprint = ps_footprint(sides.xy, sides.zw, ps_texels());
#ifdef PS_BAKED_NORMAL
  color = vec4(ps_filtered_normal(uv, footprint), 0.0);
#else
  color = ps_filtered_slope(uv, footprint);
#endif
}
