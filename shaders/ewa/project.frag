// Every splat of a view, projected once for all samples. Layout: render/passes/ewa/ewa.py.

#include "lib/geometry/footprint.glsl"
#include "lib/geometry/surfel.glsl"
#include "lib/data/attributes.glsl"
#ifdef PS_NORMAL
#include "lib/splat/lit_normal.glsl"
#endif
#include "lib/splat/ewa.glsl"

#define PS_STEEPEST 50.0  // pixels of depth that a plane may fall within one pixel; beyond, it is seen edge-on
#define PS_AFFINE_ERROR 0.1  // pixels that the affine projection of a rim may be off by
#define PS_WIDEST 32.0  // pixels: wider splats are not drawn as squares around a point

void main()
{
  ivec2 at = ivec2(gl_FragCoord.xy);
  ivec3 element = ps_element((at.y << PS_PAGE_SHIFT) + at.x);
  bool drawn = element.x >= 0;
  element = max(element, ivec3(0));
  vec4 head = texelFetch(ps_position, element.xy, 0);
  vec4 extent = texelFetch(ps_extent, element.xy, 0);
  vec3 p = ps_view_from_point(element.z, head.xyz);
  mat3 linear = ps_linear(element.z);
  bool ball = head.w < 0.0;
  vec3 n = ball ? vec3(0.0) : ps_unpack_normal(head.w);
  vec3 normal = ball ? vec3(0.0) : ps_view_normal(linear, n);
  bool perspective = ps_is_perspective();
  float d = -p.z;
  vec3 toward = perspective ? p : vec3(0.0, 0.0, -1.0);
  bool turned = dot(normal, toward) > 0.0;
#ifdef PS_CULL
  drawn = drawn && !(turned && texelFetch(ps_materials, ivec2(2, int(extent.w)), 0).x > 0.5);
#endif

  // How far the rim reaches in depth, and how fast the plane falls from pixel to pixel: with the plane n . x = n . p,
  // a ray meets it at the depth n . p / (n . ray).
  vec3 depth_row = transpose(linear)[2];
  float along = dot(depth_row, n);
  float reach = extent.x * sqrt(max(dot(depth_row, depth_row) - along * along, 0.0));
  float across = extent.x * length(depth_row);
  float pixel_size = ps_pixel_size(d);
  float facing = perspective ? dot(normal, p) / d : -normal.z;
  float steepest = PS_STEEPEST * abs(pixel_size);
  vec2 gradient = vec2(0.0);
  if (!ball) {
    float slope = -(perspective ? d : 1.0) / (abs(facing) > 1e-4 ? facing : 1e-4);
    gradient = slope * normal.xy / u.focal;
    float steep = length(gradient);
    gradient *= steep > steepest ? steepest / steep : 1.0;
  }
  // Depths within which neighbours on one surface differ, since surfaces bend, and the low-pass is as wide as it is.
  float same = ball ? 0.45 * across : 0.05 * across + 0.06 * reach + 0.25 * sqrt(u.low_pass) * length(gradient);

  vec3 pixel = ps_pixel_from_view(p);
  vec3 covariance = ps_moments(element.z, p, head.w, extent);
  float wide = 2.0 * sqrt(max(covariance.x, covariance.z));
  // Half the change in size from the near to the far rim.
  float bent = perspective ? wide * reach / d : 0.0;
  bool large = wide > PS_WIDEST || bent > PS_AFFINE_ERROR || d <= u.near;
  drawn = drawn && d + reach > u.near && d - reach < u.far && extent.x > 0.0 &&
          wide >= 0.0 && (large || wide <= PS_WIDEST);  // neither where something is not a number

  PsSurfel s = ps_empty();
  s.shape.w = floor(extent.w);
#ifdef PS_NORMAL
  s.normal.xyz = turned ? -normal : normal;
  s.normal.xyz = ps_lit_normal(s.normal.xyz, element, linear, toward, turned);
#endif
  s = ps_attributed(s, element);
  float kind = float(element.z) * 2.0 + (large ? 2.0 : 1.0);
  out_centre = vec4(pixel.xy - u.principal_point, d, drawn ? (turned ? -kind : kind) : 0.0);
  out_shape = vec4(covariance, s.shape.w);
  // Alone, a splat stands for all of its ellipse.
  float share = fract(extent.w) > 0.0 && !ball ? PS_EWA_NODE_SHARE : PS_EWA_SHARE;
  out_front = vec4(gradient, extent.y < 0.0 ? 1.0 : share, same);
#ifdef PS_NORMAL
  out_normal = s.normal;
#endif
#ifdef PS_COLOR
  out_color = s.color;
#endif
#ifdef PS_EMISSION
  out_emission = s.emission;
#endif
#ifdef PS_VELOCITY
  out_velocity = vec4(s.velocity, 0.0);
#endif
}
