// How far away what lies under each pixel's centre is, for pictures that are shown among Blender's own drawing: as the
// G-buffer's centre, which is 0 where nothing is. u.corner: where in the picture the tile begins.

#include "lib/visibility/lattice.glsl"
#include "lib/geometry/surfel_kind.glsl"

void main()
{
  uint bits = texelFetch(ps_depths, ps_central_cell(ivec2(gl_FragCoord.xy) - u.corner), 0).x;
  out_centre = bits == 0xFFFFFFFFu ? vec4(0.0) : vec4(uintBitsToFloat(bits) + u.near, 0.0, 0.0, PS_POLYGON);
}
