// The depth of a layer of each pixel, up to which translucent splats are drawn: of the group with the number u.layer; of -1, which
// is what is open, behind all. Pixels without it, and tiles where ps_wanted is 0, are nowhere. PS_PLACES: groups are not listed in
// the order of their pixels.

#include "lib/geometry/camera.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/translucent/place.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  uvec2 codes = uvec2(texelFetch(ps_first, pixel, 0).x, texelFetch(ps_second, pixel, 0).x);
  out_place = PS_NOWHERE;
  if (texelFetch(ps_wanted, pixel / PS_TILE, 0).x != 0.0) {
    if (u.layer < 0) {
      out_place = (codes.y & PS_OPEN) != 0u ? PS_BEHIND_ALL : PS_NOWHERE;
    }
    else if (u.layer < ps_group_count(codes)) {
      ivec2 entry = ps_group_texel(int(texelFetch(ps_starts, pixel, 0).x) + u.layer);
      out_place = uintBitsToFloat(texelFetch(ps_leader_depths, entry, 0).x) + u.near;
    }
  }
}
