// What groups of a list receive, from receivers in the tiles of pixels around each: one texel a group.
//   out_gathered: irradiance / pi
//   out_mirrored: mean radiance of surfaces over the glossy lobe; share of the lobe that is open
// A receiver counts the more the nearer it is in the picture, the less it lies off the group's plane and the more alike their
// normals are.

#include "lib/geometry/camera.glsl"
#include "lib/visibility/listed.glsl"

#define PS_LEAST 1e-4  // weight of a receiver that is unlike it
#define PS_ALIKE 0.8  // cosine between normals, below which receivers do not count

void main()
{
  ivec2 texel = ivec2(gl_FragCoord.xy);
  vec4 place = texelFetch(ps_places, texel, 0);
  if (place.w == 0.0) {
    discard;
  }
  vec3 up = texelFetch(ps_ups, texel, 0).xyz;
  vec2 at = vec2(ps_listed(texel).pixel) + 0.5;
  float across = float(PS_TILE) * ps_pixel_size(place.w);
  ivec2 tile = ivec2(at) / PS_TILE, tiles = textureSize(ps_tiles, 0);
  vec4 gathered = vec4(0.0), mirrored = vec4(0.0);
  float total = 0.0;
  for (int y = max(tile.y - 1, 0); y <= min(tile.y + 1, tiles.y - 1); y++) {
    for (int x = max(tile.x - 1, 0); x <= min(tile.x + 1, tiles.x - 1); x++) {
      vec2 entry = texelFetch(ps_tiles, ivec2(x, y), 0).xy;
      int first = int(entry.x), end = first + int(entry.y);
      for (int i = first; i < end; i++) {
        ivec2 receiver = ivec2(i & (PS_RECEIVER_WIDTH - 1), i / PS_RECEIVER_WIDTH);
        ivec2 fields = ivec2(3 * receiver.x, receiver.y);
        vec3 offset = texelFetch(ps_receivers, fields, 0).xyz - place.xyz;
        vec4 other = texelFetch(ps_receivers, fields + ivec2(1, 0), 0);
        vec2 where = texelFetch(ps_receiver_pixels, receiver, 0).xy;
        vec2 apart = abs(where - at) / (1.5 * float(PS_TILE));
        float off = (abs(dot(offset, up)) + abs(dot(offset, other.xyz))) / across;
        float tent = max(1.0 - apart.x, 0.0) * max(1.0 - apart.y, 0.0);
        float alike = clamp((dot(up, other.xyz) - PS_ALIKE) / (1.0 - PS_ALIKE), 0.0, 1.0);
        float weight = tent * alike * max(1.0 - off, 0.0);
        weight += PS_LEAST * max(dot(up, other.xyz), 0.01) / (1.0 + off * off);
        gathered += weight * texelFetch(ps_found_diffuse, receiver, 0);
        mirrored += weight * texelFetch(ps_found_glossy, receiver, 0);
        total += weight;
      }
    }
  }
  out_gathered = gathered / max(total, 1e-20);
  out_mirrored = mirrored / max(total, 1e-20);
}
