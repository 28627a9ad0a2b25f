// The same as image_space/project.comp for devices without image atomics: one-pixel points through the depth test. Of equally
// near splats the first one drawn stays.

#include "lib/geometry/footprint.glsl"

void main()
{
  ps_id = uint(u.first_index + gl_VertexID);
  ps_order = 1.0;
  gl_PointSize = 1.0;
#ifdef PS_DISCONNECTED
  ps_ellipse = vec3(0.0);
  ps_centre = vec2(0.0);
#endif
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  ivec3 element = ps_element(gl_VertexID);
  if (element.x < 0) {
    return;
  }
  vec4 head = texelFetch(ps_position, element.xy, 0);
  vec3 view = ps_view_from_point(element.z, head.xyz);
  vec3 pixel = ps_pixel_from_view(view);
  if (!ps_in_frame(pixel)) {
    return;
  }
#ifdef PS_CULL
  int material = int(texelFetch(ps_extent, element.xy, 0).w);
  if (texelFetch(ps_materials, ivec2(2, material), 0).x > 0.5 && head.w >= 0.0) {
    vec3 normal = ps_view_normal(ps_linear(element.z), ps_unpack_normal(head.w));
    vec3 toward = ps_is_perspective() ? -view : vec3(0.0, 0.0, 1.0);
    if (dot(normal, toward) < 0.0) {
      return;
    }
  }
#endif
  // The pixel's centre, so that no rasteriser's rule for ties moves the point.
  vec2 centre = floor(pixel.xy) + 0.5;
  vec4 extent = texelFetch(ps_extent, element.xy, 0);
  vec3 covariance = ps_footprint(element.z, view, head.w, extent);
#ifdef PS_DISCONNECTED
  if (ps_alone(covariance, extent)) {
    ps_ellipse = covariance;
    ps_centre = pixel.xy;
    vec2 reach = 2.0 * sqrt(covariance.xz);
    gl_PointSize = 2.0 * max(reach.x, reach.y) + 2.0;
    ps_order = 0.5 * ps_buffer_depth(pixel.z);
    gl_Position = vec4(pixel.xy / vec2(u.size) * 2.0 - 1.0, 0.0, 1.0);
    return;
  }
#endif
  uint beside = ps_off_centre(covariance, pixel.xy - centre);
  ps_id |= beside;
  // Splats that miss the pixel's centre come after all that hold it: the far half of the depth range. Written by the
  // fragment shader, since clip space would round it to a part of the whole range.
  ps_order = 0.5 * ps_buffer_depth(pixel.z) + (beside == 0u ? 0.0 : 0.5);
  gl_Position = vec4(centre / vec2(u.size) * 2.0 - 1.0, 0.0, 1.0);
}
