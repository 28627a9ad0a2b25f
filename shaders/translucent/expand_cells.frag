// What each sub-sample of a block of pixels shows that is opaque, and its depth, one texel a cell. Cells beyond the block, and
// of tiles where nothing is blended, are nowhere. u.corner: the first cell; u.low, u.high: the block's pixels. Texels of
// ps_numbers: of sub-samples by their cells from the pixel's central one, which is in the middle. PS_BEHIND: what open
// sub-samples show. PS_PLACES: groups are not listed in the order of their pixels.

#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/translucent/place.glsl"

void main()
{
  ivec2 cell = ivec2(gl_FragCoord.xy) + u.corner, pixel = ivec2(floor(ps_pixel_from_cell(vec2(cell) + 0.5)));
  out_layer = vec4(0.0);
  out_place = PS_NOWHERE;
  bool inside = all(greaterThanEqual(pixel, u.low)) && all(lessThan(pixel, u.high));
  if (inside && texelFetch(ps_wanted, pixel / PS_TILE, 0).x != 0.0) {
    uvec2 codes = uvec2(texelFetch(ps_first, pixel, 0).x, texelFetch(ps_second, pixel, 0).x);
    ivec2 beside = cell - ps_central_cell(pixel) + textureSize(ps_numbers, 0) / 2;
    uint group = ps_group(codes, int(texelFetch(ps_numbers, beside, 0).x));
    bool open = group == PS_NO_GROUP;
    out_place = open ? PS_BEHIND_ALL : uintBitsToFloat(texelFetch(ps_depths, cell, 0).x) + u.near;
    int entry = int(texelFetch(ps_starts, pixel, 0).x) + (open ? 0 : int(group));
    vec4 shown = open ? vec4(0.0) : texelFetch(ps_combined, ps_group_texel(entry), 0);
#ifdef PS_BEHIND
    shown = open ? texelFetch(ps_behind, pixel, 0) : shown;
#endif
    out_layer = shown;
  }
}
