// A picture over footprints: of each column of `rows` UV, and the sides of a parallelogram in UV.

#include "lib/data/levels.glsl"

void main()
{
  ivec2 first = ivec2(int(gl_FragCoord.x), 0);
  vec2 uv = texelFetch(rows, first, 0).xy;
  vec4 sides = texelFetch(rows, first + ivec2(0, 1), 0);
  PsFootprint footprint = ps_footprint(sides.xy, sides.zw, vec2(ps_picture_size(picture)));
  color = ps_filtered(picture, levels, uv, footprint, false, false, false);
}
