// Depth of the opaque surface under each pixel's centre.

#include "lib/geometry/camera.glsl"
#include "lib/geometry/surfel_kind.glsl"
#include "lib/geometry/geometry.glsl"
#include "lib/translucent/place.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec4 centre = texelFetch(ps_centre, pixel, 0);
  out_depth = PS_BEHIND_ALL;
  if (ps_is_there(centre)) {
    out_depth = centre.x;
#ifdef PS_NORMAL
    vec3 stored = texelFetch(ps_normal, pixel, 0).xyz;
    vec3 normal = ps_surface_normal(stored, centre, texelFetch(ps_shape, pixel, 0), gl_FragCoord.xy);
    out_depth = -ps_surface_position(normal, stored, centre, gl_FragCoord.xy).z;
#endif
  }
}
