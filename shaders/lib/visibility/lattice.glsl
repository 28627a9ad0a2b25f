// Between pixels and the cells of a lattice of sub-samples: core/numeric/lattice.py. u.lattice: p, q, and where pixel
// coordinates (0, 0) lie in cells. u.cells: columns and rows of cells. PS_LATTICE: the pass has these.

#include "lib/geometry/camera.glsl"

#ifdef PS_LATTICE

vec2 ps_cell_from_pixel(vec2 pixel)
{
  return vec2(u.lattice.x * pixel.x - u.lattice.y * pixel.y, u.lattice.y * pixel.x + u.lattice.x * pixel.y) +
         u.lattice.zw;
}

vec2 ps_pixel_from_cell(vec2 cell)
{
  vec2 d = cell - u.lattice.zw;
  return vec2(u.lattice.x * d.x + u.lattice.y * d.y, u.lattice.x * d.y - u.lattice.y * d.x) /
         dot(u.lattice.xy, u.lattice.xy);
}

// The cell at a pixel's centre.
ivec2 ps_central_cell(ivec2 pixel)
{
  return ivec2(floor(ps_cell_from_pixel(vec2(pixel) + 0.5)));
}

// From clip space of the picture to clip space of the target of cells.
vec4 ps_cell_clip(vec4 clip)
{
  vec2 pixel = 0.5 * (clip.xy + clip.w) * vec2(u.size);  // times w
  vec2 cell = vec2(u.lattice.x * pixel.x - u.lattice.y * pixel.y, u.lattice.y * pixel.x + u.lattice.x * pixel.y) +
              u.lattice.zw * clip.w;
  return vec4(2.0 * cell / u.cells - clip.w, clip.zw);
}

#endif
