// What translucent splats send from before the groups of one layer of pixels, and what they hide, from pixels into the list of
// groups. PS_TINT: and their optical depths, of each channel.

#include "lib/geometry/camera.glsl"
#include "lib/visibility/listed.glsl"

void main()
{
  PsListed listed = ps_listed(ivec2(gl_FragCoord.xy));
  if (listed.layer != u.layer) {
    discard;
  }
  out_listed = texelFetch(ps_layer, listed.pixel, 0);
#ifdef PS_TINT
  out_listed_depths = texelFetch(ps_layer_depths, listed.pixel, 0);
#endif
}
