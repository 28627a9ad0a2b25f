// From a texel of the G-buffer back to the surface under a pixel's centre.

// A ball's normal follows from where in its disk the pixel lies.
vec3 ps_surface_normal(vec3 stored, vec4 centre, vec4 shape, vec2 pixel)
{
  if (dot(stored, stored) > 1e-6) {
    return normalize(stored);
  }
  vec2 across = clamp(-centre.yz / max(2.0 * shape.xz, vec2(1e-6)), vec2(-1.0), vec2(1.0));
  vec3 n = vec3(across, sqrt(max(1.0 - dot(across, across), 0.0)));
  vec3 toward = -ps_ray(pixel);
  // The frame of the ray that keeps its first axis near x and its second near y.
  vec3 axis_x = normalize(cross(vec3(0.0, 1.0, 0.0), toward) + vec3(1e-9, 0.0, 0.0));
  vec3 axis_y = cross(toward, axis_x);
  return normalize(n.x * axis_x + n.y * axis_y + n.z * toward);
}

// The splat's centre is not under the pixel's: go along the ray to the splat's plane, but no farther than it extends.
vec3 ps_surface_position(vec3 normal, vec3 stored, vec4 centre, vec2 pixel)
{
  if (centre.w <= PS_POLYGON || dot(stored, stored) <= 1e-6) {
    return ps_view_from_pixel(pixel, centre.x);
  }
  vec3 middle = ps_view_from_pixel(pixel + centre.yz, centre.x);
  vec3 here = ps_view_from_pixel(pixel, centre.x);
  vec3 along = ps_is_perspective() ? here / max(centre.x, 1e-20) : vec3(0.0, 0.0, -1.0);
  float slope = dot(normal, along);
  float step = abs(slope) > 1e-4 ? dot(normal, middle - here) / slope : 0.0;
  float d = centre.x + clamp(step, -centre.w, centre.w);
  return ps_view_from_pixel(pixel, d);
}
