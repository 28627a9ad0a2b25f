// The ball that a pixel's ray meets, into the G-buffer that points and polygons share.

#include "lib/data/splat.glsl"
#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"
#include "lib/data/attributes.glsl"

void main()
{
  // The ray where the ball is the unit ball; its parameter is the depth.
  vec3 here = ps_view_from_pixel(gl_FragCoord.xy, 1.0);
  vec3 eye = (ps_is_perspective() ? vec3(0.0) : vec3(here.xy, 0.0)) - v_centre;
  vec3 along = ps_is_perspective() ? here : vec3(0.0, 0.0, -1.0);
  eye = vec3(dot(v_row0, eye), dot(v_row1, eye), dot(v_row2, eye));
  along = vec3(dot(v_row0, along), dot(v_row1, along), dot(v_row2, along));
  float a = dot(along, along);
  // From the point of the ray that is nearest to the centre, so that far balls keep their precision.
  float middle = -dot(eye, along) / a;
  vec3 nearest = eye + middle * along;
  float outside = 1.0 - dot(nearest, nearest);
  if (outside < 0.0) {
    discard;
  }
  float half_chord = sqrt(outside / a);
  float d = middle - half_chord;
  // Cut open by the near plane, a ball shows its inside.
  d = d < u.near ? middle + half_chord : d;
  if (d < u.near || d > u.far) {
    discard;
  }
  PsSurfel s = ps_empty();
  s.centre = vec4(d, 0.0, 0.0, PS_POLYGON);
  ivec3 element = ivec3(v_element);
  s.shape.w = texelFetch(ps_extent, element.xy, 0).w;
#ifdef PS_NORMAL
  vec3 n = nearest + (d - middle) * along;
  s.normal.xyz = normalize(v_row0 * n.x + v_row1 * n.y + v_row2 * n.z);
#endif
  s = ps_attributed(s, element);
  ps_store_front(s, true);
  gl_FragDepth = ps_buffer_depth(d);
}
