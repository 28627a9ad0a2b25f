// Projection between view space and pixels. u.focal and u.principal_point are those of core.scene.Camera.pixel_from_view;
// depth d = -z grows away from the eye. The reference is tests/reference/opaque.py.

bool ps_is_perspective()
{
  return u.perspective == 1;
}

// Pixel coordinates and depth of a point in view space. `precise`, so that two passes agree to the last bit.
vec3 ps_pixel_from_view(vec3 p)
{
  precise float d = -p.z;
  precise float scale = ps_is_perspective() ? 1.0 / d : 1.0;
  precise float x = u.focal.x * (p.x * scale) + u.principal_point.x;
  precise float y = u.focal.y * (p.y * scale) + u.principal_point.y;
  return vec3(x, y, d);
}

vec3 ps_view_from_pixel(vec2 pixel, float d)
{
  vec2 xy = (pixel - u.principal_point) / u.focal;
  return vec3(ps_is_perspective() ? xy * d : xy, -d);
}

// Unit direction from the eye through a pixel.
vec3 ps_ray(vec2 pixel)
{
  return ps_is_perspective() ? normalize(vec3((pixel - u.principal_point) / u.focal, -1.0)) : vec3(0.0, 0.0, -1.0);
}

// World units that a pixel spans at depth d.
float ps_pixel_size(float d)
{
  return (ps_is_perspective() ? d : 1.0) / u.focal.x;
}

bool ps_in_frame(vec3 pixel)
{
  return pixel.z > u.near && pixel.z < u.far && pixel.x >= 0.0 && pixel.y >= 0.0 &&
         pixel.x < float(u.size.x) && pixel.y < float(u.size.y);
}

// Depth for the depth buffer: linear, since it only orders points and polygons of one frame.
float ps_buffer_depth(float d)
{
  return clamp((d - u.near) / (u.far - u.near), 0.0, 1.0);
}

// Rasterised with the picture's own projection; depth is linear, and written by the fragment shader.
vec4 ps_clip_from_view(vec3 p)
{
  vec2 offset = 2.0 * u.principal_point / vec2(u.size) - 1.0;
  vec2 scale = 2.0 * u.focal / vec2(u.size);
  float w = ps_is_perspective() ? -p.z : 1.0;
  float near = u.near, far = u.far;
  // Clips at the near and far plane: z / w in [-1, 1] between them, and not above 1 by rounding, where near is nothing
  // beside w.
  float z = ps_is_perspective() ? w - 2.0 * near * ((far - w) / (far - near))
                                : (-2.0 * p.z - far - near) / (far - near);
  return vec4(scale * p.xy + offset * w, z, w);
}
