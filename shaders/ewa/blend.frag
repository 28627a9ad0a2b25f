// What a splat brings to a pixel. PS_BLEND: its attributes times its kernel, where it belongs to the nearest surface;
// else the depth of its plane and its identity, where its ellipse holds the pixel's centre. Layout: render/passes/ewa/ewa.py.

#include "lib/geometry/camera.glsl"
#include "lib/splat/ewa.glsl"
#include "lib/geometry/surfel_kind.glsl"
#include "lib/geometry/geometry.glsl"

void main()
{
#ifdef PS_LARGE
  // The ray meets the plane: exact where the projection of the ellipse is not affine.
  vec3 here = ps_view_from_pixel(gl_FragCoord.xy, 1.0);
  bool perspective = ps_is_perspective();
  vec3 ray = perspective ? here : vec3(0.0, 0.0, -1.0);
  vec3 start = perspective ? vec3(0.0) : vec3(here.xy, 0.0);
  float facing = dot(v_plane.xyz, ray);
  facing = abs(facing) > 1e-9 ? facing : 1e-9;
  float depth = (v_plane.w - dot(v_plane.xyz, start)) / facing;
  vec2 uv = vec2(dot(v_u.xyz, start + depth * ray) - v_u.w, dot(v_v.xyz, start + depth * ray) - v_v.w);
  if (!(depth > u.near && depth < u.far)) {
    discard;
  }
#ifdef PS_BLEND
  // Change of uv from pixel to pixel; the low-pass widens the kernel there as it does the affine one.
  vec2 step = (perspective ? depth : 1.0) / u.focal;
  vec2 du = step.x * (vec2(v_u.x, v_v.x) - vec2(dot(v_u.xyz, ray), dot(v_v.xyz, ray)) * v_plane.x / facing);
  vec2 dv = step.y * (vec2(v_u.y, v_v.y) - vec2(dot(v_u.xyz, ray), dot(v_v.xyz, ray)) * v_plane.y / facing);
  float pass = 4.0 * u.low_pass;
  vec3 c = vec3(1.0, 0.0, 1.0) + pass * (vec3(du.x * du.x, du.x * du.y, du.y * du.y) +
                                         vec3(dv.x * dv.x, dv.x * dv.y, dv.y * dv.y));
  float det = c.x * c.z - c.y * c.y;
  float q = 4.0 * (c.z * uv.x * uv.x - 2.0 * c.y * uv.x * uv.y + c.x * uv.y * uv.y) / det;
  float peak = ps_ewa_peak(v_front.z, 1.0, det);
#else
  float q = 4.0 * dot(uv, uv);
#endif
  vec2 v = gl_FragCoord.xy - v_centre.xy;
#else
  vec2 v = gl_FragCoord.xy - v_centre.xy;
  float q = v_conic.x * v.x * v.x + 2.0 * v_conic.y * v.x * v.y + v_conic.z * v.y * v.y;
  float depth = v_centre.z + dot(v_front.xy, v);
  float peak = v_conic.w;
#endif
#ifdef PS_BLEND
  if (!(q <= PS_EWA_CUTOFF)) {
    discard;
  }
  vec4 nearest = texelFetch(ps_nearest, ivec2(gl_FragCoord.xy), 0);
  // The range of the flatter of both: steep planes reach far in front of what lies beside them, and behind.
  float behind = depth - u.near - nearest.x, same = 2.0 * min(v_front.w, nearest.y - u.near - nearest.x);
#ifdef PS_HARD
  // What lies in front, yet is not the nearest, lies beside the sample.
  if (nearest.x == 0.0 || abs(behind) > same) {
    discard;
  }
#else
  if (nearest.x > 0.0 && behind > same) {
    discard;
  }
#endif
  float w = peak * exp(-0.5 * q);
  bool back = v_centre.w < 0.0;
  w *= back && !ps_back_seen(nearest) ? PS_EWA_BACK : 1.0;
  out_depth = w * vec4(depth, v_material.x, back ? 0.0 : 1.0, 1.0);
#ifdef PS_NORMAL
#ifdef PS_BALLS
  vec3 bulge = ps_surface_normal(v_normal.xyz, vec4(v_centre.z, -v, 0.0), vec4(v_material.z, 0.0, v_material.w, 0.0),
                                 gl_FragCoord.xy);
  out_normal = w * vec4(bulge, v_normal.w);
#else
  out_normal = w * v_normal;
#endif
#endif
#ifdef PS_COLOR
  out_color = w * v_color;
#endif
#ifdef PS_EMISSION
  out_emission = w * v_emission;
#endif
#ifdef PS_VELOCITY
  out_velocity = w * v_velocity;
#endif
#else
  if (!(q <= v_conic.w && depth > u.near && depth < u.far)) {
    discard;
  }
  // Ellipses that are seen nearly edge-on reach beyond the edge of a closed surface: their backs are not meant.
  bool back = v_centre.w < 0.0 && length(v_front.xy) < PS_EWA_STEEP * abs(ps_pixel_size(v_centre.z));
  // Beyond the near plane, so that 0 means that there is nothing.
  out_nearest = vec4(depth - u.near, depth + v_front.w, v_material.x, 2.0 * v_material.y + (back ? 1.0 : 0.0));
  gl_FragDepth = ps_buffer_depth(depth);
#endif
}
