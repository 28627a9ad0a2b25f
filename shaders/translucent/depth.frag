// Depth of the opaque surface under each pixel's centre.

#include "lib/geometry/camera.glsl"
#include "lib/data/place.glsl"
#include "lib/geometry/geometry.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec4 place = texelFetch(ps_place, pixel, 0);
  out_depth = 1e30;
  if (ps_is_there(place)) {
    out_depth = place.x;
#ifdef PS_NORMAL
    vec3 stored = texelFetch(ps_normal, pixel, 0).xyz;
    vec3 normal = ps_surface_normal(stored, place, texelFetch(ps_shape, pixel, 0), gl_FragCoord.xy);
    out_depth = -ps_surface_position(normal, stored, place, gl_FragCoord.xy).z;
#endif
  }
}
