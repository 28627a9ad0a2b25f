// What a block of pixels shows that is opaque, at a few places of each, one texel a cell of their lattice: blurred as splats are
// that are looked at there; and its depth. Cells beyond the block, and of tiles where nothing is blended, are nowhere.
// u.corner: the first cell; u.low, u.high: the block's pixels. Texels of ps_opaque and ps_place: of pixels (expand.frag).
// PS_DEVIATION: of the blur, in pixels.

#include "lib/visibility/lattice.glsl"
#include "lib/translucent/place.glsl"
#include "lib/splat/kernel.glsl"

void main()
{
  vec2 at = ps_pixel_from_cell(gl_FragCoord.xy + vec2(u.corner));
  ivec2 pixel = ivec2(floor(at)), last = textureSize(ps_opaque, 0) - 1;
  out_opaque = vec4(0.0);
  out_place = PS_NOWHERE;
  bool inside = all(greaterThanEqual(pixel, u.low)) && all(lessThan(pixel, u.high));
  if (inside && texelFetch(ps_wanted, pixel / PS_TILE, 0).x != 0.0) {
    out_place = texelFetch(ps_place, pixel, 0).x;
    vec2 within = at - vec2(pixel);
    vec2 below = vec2(ps_below(-within.x / PS_DEVIATION), ps_below(-within.y / PS_DEVIATION));
    vec2 above = vec2(ps_below((within.x - 1.0) / PS_DEVIATION), ps_below((within.y - 1.0) / PS_DEVIATION));
    for (int y = -1; y <= 1; y++) {
      for (int x = -1; x <= 1; x++) {
        vec2 share = vec2(x < 0 ? below.x : x > 0 ? above.x : 1.0 - below.x - above.x,
                          y < 0 ? below.y : y > 0 ? above.y : 1.0 - below.y - above.y);
        out_opaque += share.x * share.y * texelFetch(ps_opaque, clamp(pixel + ivec2(x, y), ivec2(0), last), 0);
      }
    }
  }
}
