// A layer of panes behind those before it, one texel a cell: render/passes/translucent/pane_layers.py. Texels of ps_numbers: of
// sub-samples by their cells from the pixel's central one, which is in the middle; of ps_through: what passes each group, and
// its alpha; PS_TRANSMITTED, where the light is what glass lets through: whether it is glass. PS_PLACES: groups are not listed in the order of their pixels.
// The light L(d) of translucent splats up to a depth d counts by what the panes behind d hide: in the end, each part of it has passed
// the panes before it alone.

// PS_CENTRED: the light without these splats, too.

#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/translucent/before.glsl"

#define PS_OPEN_CELL 0xFFFFFFFFu
#define PS_CLOSED 0.0009765625  // of the light behind that passes: less is not measurable

void main()
{
  ivec2 cell = ivec2(gl_FragCoord.xy), pixel = ivec2(floor(ps_pixel_from_cell(vec2(cell) + 0.5)));
  out_light = texelFetch(ps_light, cell, 0);
  out_hidden = texelFetch(ps_hidden, cell, 0);
  out_following = 0u;
#ifdef PS_CENTRED
  out_bare = texelFetch(ps_bare, cell, 0);
#endif
  uint depth = texelFetch(ps_depths, cell, 0).x;
  bool inside = all(greaterThanEqual(pixel, ivec2(0))) && all(lessThan(pixel, u.size));
  if (inside && depth != PS_OPEN_CELL) {
    uvec2 codes = uvec2(texelFetch(ps_first, pixel, 0).x, texelFetch(ps_second, pixel, 0).x);
    ivec2 beside = cell - ps_central_cell(pixel) + textureSize(ps_numbers, 0) / 2;
    uint group = ps_group(codes, int(texelFetch(ps_numbers, beside, 0).x));
    if (group != PS_NO_GROUP) {
      ivec2 entry = ps_group_texel(int(texelFetch(ps_starts, pixel, 0).x) + int(group));
      vec4 through = texelFetch(ps_through, entry, 0);
      vec3 left = 1.0 - out_hidden.rgb, seen = left;
#ifdef PS_AMONG_SPLATS
      PsBefore before = ps_before(cell, pixel, entry, false);
      seen *= 1.0 - before.hidden;
#endif
#ifdef PS_TRANSMITTED
      vec3 own = through.w * through.rgb, passes = (1.0 - through.w) * through.rgb;
#else
      vec3 own = through.w * texelFetch(ps_combined, entry, 0).rgb, passes = through.rgb;
#endif
      out_light.rgb += seen * own;
#ifdef PS_CENTRED
      out_bare.rgb += left * own;
#endif
      left *= passes;
#ifdef PS_AMONG_SPLATS
      out_light.rgb += (1.0 - out_hidden.rgb - left) * before.light;
#endif
      out_hidden.rgb = 1.0 - left;
      out_following = max(left.r, max(left.g, left.b)) < PS_CLOSED ? 0u : ~(depth + 1u);
    }
  }
}
