// One captured splat of the draw list, as lit splats are (render/passes/translucent/light.py): its ellipse in pixels, its
// opacity, and the light that it sends to the eye. core/splat/captured.py has the formula, render/passes/captured/project.py
// the layouts. u.first: texel of the first splat of the list; u.instances: the first of this page's, and the one behind its
// last. PS_TRAINED: display values are blended. u.low_pass: that of the pixels for which wider ones stand while a view moves: what these widen more hides no more.
// PS_SHADOWED, PS_RELIT: light changes what they send. PS_ANTIALIASED: what the low-pass widens loses opacity.
// PS_AMONG_OPAQUE: something opaque may stand among them.

#include "lib/geometry/camera.glsl"
#include "lib/geometry/finite.glsl"
#include "lib/captured/harmonics.glsl"
#include "lib/captured/kind.glsl"
#ifndef PS_TRAINED
#include "lib/captured/display.glsl"
#endif
#if defined(PS_SHADOWED) || defined(PS_RELIT)
#include "lib/geometry/direction.glsl"
#include "lib/light/lights.glsl"
#include "lib/captured/lit.glsl"
#endif

#define PS_UNCUT 0.25  // opacity of splats that are antialiased: they do not end where they are too faint one by one
#define PS_WIDEST 1e6  // pixels: half-axes of what is wider are as wide, which pictures cannot show

vec2 ps_limited(vec2 half_axis)
{
  float size = length(half_axis);
  return size > PS_WIDEST ? half_axis * (PS_WIDEST / size) : half_axis;
}

void main()
{
  ivec2 here = ivec2(gl_FragCoord.xy);
  int row = here.x + 4096 * here.y - u.first;
  if (row < 0 || row >= u.count) {
    discard;
  }
  vec2 entry = texelFetch(ps_order, ivec2(row & 4095, row >> 12), 0).xy;
  int low = int(entry.x), high = int(entry.y), instance = high >> 2;
  if (instance < u.instances.x || instance >= u.instances.y) {
    discard;
  }
  int index = low + ((high & 3) << 24);
  ivec2 at = ivec2(index & 4095, index >> 12);
  vec4 head = texelFetch(ps_position, at, 0), turn = texelFetch(ps_rotation, at, 0);
  vec3 scale = texelFetch(ps_scale, at, 0).xyz;
  vec4 rows[3], more = texelFetch(ps_views, ivec2(3, instance), 0);
  for (int i = 0; i < 3; i++) {
    rows[i] = texelFetch(ps_views, ivec2(i, instance), 0);
  }

  // Half-axes in view space: columns of V R S.
  vec4 q = vec4(head.xyz, 1.0);
  vec3 p = vec3(dot(rows[0], q), dot(rows[1], q), dot(rows[2], q));
  mat3 linear = transpose(mat3(rows[0].xyz, rows[1].xyz, rows[2].xyz));
  turn = normalize(turn);
  float w = turn.x, x = turn.y, y = turn.z, z = turn.w;
  mat3 rotation = mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
                       2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
                       2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
  mat3 axes = linear * rotation;
  vec3 a = axes[0] * scale.x, b = axes[1] * scale.y, c = axes[2] * scale.z;

  // The covariance in pixels. Its determinant is a sum of squares, without cancellation.
  float d = -p.z, over = ps_is_perspective() ? 1.0 / d : 1.0;
  vec2 slope = ps_is_perspective() ? clamp(p.xy * over, u.slopes.xy, u.slopes.zw) : vec2(0.0);
  vec2 focal = u.focal * over;
  vec2 ua = ps_limited(focal * (a.xy + slope * a.z)), ub = ps_limited(focal * (b.xy + slope * b.z));
  vec2 uc = ps_limited(focal * (c.xy + slope * c.z));
  vec3 own = vec3(ua.x * ua.x + ub.x * ub.x + uc.x * uc.x, ua.x * ua.y + ub.x * ub.y + uc.x * uc.y,
                  ua.y * ua.y + ub.y * ub.y + uc.y * uc.y);
  vec3 areas = vec3(ua.x * ub.y - ua.y * ub.x, ub.x * uc.y - ub.y * uc.x, uc.x * ua.y - uc.y * ua.x);
  float before = dot(areas, areas), det = before + PS_LOW_PASS * (own.x + own.z + PS_LOW_PASS);
  vec3 wide = own + vec3(PS_LOW_PASS, 0.0, PS_LOW_PASS);
  float opacity = head.w;
#ifdef PS_NODES
  // As much is hidden as by the splats for which the node stands, each of which the low-pass widens: the roots of their
  // determinants are those of the mean splat, which is as wide from all sides.
  vec4 means = texelFetch(ps_means, at, 0);
#ifdef PS_ANTIALIASED
  float kind = PS_NODE_KIND + PS_UNCUT;
  opacity *= sqrt(before / det);
#else
  // The mean area of an ellipsoid's pictures is a quarter of its surface (Cauchy).
  float pixels = pow(abs(determinant(linear)), 0.6666667) * abs(focal.x * focal.y);
  float area = means.w * pixels, trace = means.z * pixels / 1.5;
  float widened = sqrt(area * area + u.low_pass * (trace + u.low_pass));
  float kind = PS_NODE_KIND + max(means.y, 2.0 * PS_LEAST_ALPHA);
  opacity = means.x * widened / sqrt(det);
#endif
#else
#ifdef PS_ANTIALIASED
  opacity *= sqrt(before / det);
#else
  if (u.low_pass < PS_LOW_PASS) {
    opacity *= sqrt((before + u.low_pass * (own.x + own.z + u.low_pass)) / det);
  }
#endif
  const float kind = PS_CAPTURED_KIND;
#endif

  vec3 direction = ps_is_perspective() ? head.xyz - more.xyz : more.xyz;
  direction *= 1.0 / max(max(abs(direction.x), abs(direction.y)), max(abs(direction.z), 1e-30));
  vec3 display = max(ps_harmonic_sum(index, normalize(direction)) + 0.5, vec3(0.0));
#ifdef PS_TRAINED
  vec3 radiance = display;
#else
  vec3 radiance = ps_linear_from_display(display);
#endif
#if defined(PS_SHADOWED) || defined(PS_RELIT)
  // Normals are of either side: that is lit which is seen.
  vec3 to_eye = ps_is_perspective() ? normalize(-p) : vec3(0.0, 0.0, 1.0), n = texelFetch(ps_normal, at, 0).xyz;
  vec3 facing = cross(linear[1], linear[2]) * n.x + cross(linear[2], linear[0]) * n.y + cross(linear[0], linear[1]) * n.z;
  facing = ps_direction(facing, to_eye);
  facing *= dot(facing, to_eye) < 0.0 ? -1.0 : 1.0;
#ifdef PS_SHADOW_SPREAD
  ps_spread = PsSpread(uint(index), PS_EVERY_POINT);
#endif
#ifdef PS_RELIT
  ps_lift = PS_LIFT * sqrt(0.5 * (dot(a, a) + dot(b, b) + dot(c, c))) * facing;
#endif
  radiance *= ps_captured_light(p, facing, to_eye, u.light_count);
#endif
#ifdef PS_DARK
  radiance = vec3(0.0);
#endif
#ifdef PS_WHITE
  radiance = vec3(1.0);
#endif
  bool seen = d > u.near && d < u.far && opacity >= PS_LEAST_ALPHA && det < 1e30;
  out_centre = seen ? vec4(u.focal * p.xy * over, d, opacity) : vec4(0.0);
  out_shape = seen ? vec4(wide, det) : vec4(1.0, 0.0, 1.0, 1.0);
  out_source = vec4(ps_finite(radiance), kind);
#ifdef PS_HOLDOUT
  if (more.w > 0.5) {
    out_source = vec4(0.0, 0.0, 0.0, -1.0 - kind);
  }
#endif
#ifdef PS_AMONG_OPAQUE
  // Regression of depth on the position in the picture, and what it leaves of the variance.
  vec3 deep = -vec3(a.z, b.z, c.z);
  vec2 together = deep.x * ua + deep.y * ub + deep.z * uc;
  vec2 gradient = vec2(wide.z * together.x - wide.y * together.y, wide.x * together.y - wide.y * together.x) / det;
  float variance = max(dot(deep, deep) - dot(gradient, together), 1e-10 * d * d);
  out_front = vec4(sqrt(variance), gradient, sqrt(max(dot(a, a), max(dot(b, b), dot(c, c)))));
#endif
#ifdef PS_TINT
  out_tint = vec4(1.0);
#endif
}
