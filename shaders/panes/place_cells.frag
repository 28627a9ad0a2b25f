// The depth of each sub-sample, one texel a cell, up to which translucent splats are drawn. Tiles where ps_wanted is 0 are nowhere,
// and so is what is open; PS_OPEN_TOO: that is behind all.

#include "lib/visibility/lattice.glsl"
#include "lib/translucent/place.glsl"

#define PS_OPEN_CELL 0xFFFFFFFFu

void main()
{
  ivec2 cell = ivec2(gl_FragCoord.xy), pixel = ivec2(floor(ps_pixel_from_cell(vec2(cell) + 0.5)));
  out_place = PS_NOWHERE;
  bool inside = all(greaterThanEqual(pixel, ivec2(0))) && all(lessThan(pixel, u.size));
  if (inside && texelFetch(ps_wanted, pixel / PS_TILE, 0).x != 0.0) {
    uint bits = texelFetch(ps_depths, cell, 0).x;
#ifdef PS_OPEN_TOO
    out_place = bits == PS_OPEN_CELL ? PS_BEHIND_ALL : uintBitsToFloat(bits) + u.near;
#else
    out_place = bits == PS_OPEN_CELL ? PS_NOWHERE : uintBitsToFloat(bits) + u.near;
#endif
  }
}
