// One translucent splat of the draw list: its ellipse in pixels, its optical depth and the light that it sends to the
// eye. Texel by texel; layouts: render/passes/translucent/page.py. Reference: scripts/common/media_truth.py.
// PS_REACH: of every splat of a page instead, the shares of this many lights that reach it; PS_REACHED: they are known;
// PS_REACH_COLORED, PS_REACHED_COLORED: of each channel.
// PS_KERNELS: some have a kernel of their own. PS_HOLDOUT: instances may cut holes instead.
// PS_FUZZY: some are opaque (core/splat/painter.py), whose kernels are narrower by this factor. PS_CULL: some of these are not
// drawn where they show their backs, PS_FUZZY_DISCONNECTED: some stand apart. PS_DEFOCUS: for the pass of what is out of focus,
// render/passes/defocus/gather.py, PS_SLOPES: planes of surfaces are told, PS_STRANDS: with pieces of strands. PS_MEDIA: some fill a volume. PS_AMONG_OPAQUE: something
// opaque may stand among them. PS_CENTRES: they are looked at in pixels' centres alone. PS_INDIRECT: what surfaces receive from each
// other is known; PS_PLACES: instead of light, where they are, as in indirect/group_points.frag, with the negative depth of backs.

#include "lib/geometry/camera.glsl"
#include "lib/geometry/direction.glsl"
#include "lib/splat/kernel.glsl"
#include "lib/data/pack.glsl"
#include "lib/light/lights.glsl"
#include "lib/fog/in_fog.glsl"
#include "lib/data/materials.glsl"
#include "lib/geometry/finite.glsl"
#ifdef PS_DEFOCUS
#include "lib/splat/defocus.glsl"
#endif
#ifdef PS_STRANDS
#include "lib/strands/hair.glsl"
#endif

#define PS_LOW_PASS 0.04  // pixels^2: splats smaller than a pixel are not missed between the pixels' centres
#define PS_PARTICLE 1.0  // kinds of media: what is strewn, and what fills a lattice evenly
#define PS_GAMMA 0.90640248  // core/splat/painter.py
#define PS_VIEW 1.3  // of the picture's half width: beyond it the perspective is taken as at its rim
#define PS_PIXEL 0.3  // pixels^2: what stands for a pixel, where its centre alone is looked at
#define PS_VOXEL_DEPTH 1.02625  // optical depth across a voxel over a splat's `peak`: 2 pi EVEN_SPACING^2, core/splat/kernel.py
#define PS_FAINT 1e-7  // optical depth of what only emits
#define PS_FAINT_TINT 1e-4  // least extinction of a channel over that of the strongest

ivec2 ps_texel(int index)
{
  return ivec2(index & 4095, index >> 12);
}

vec4 ps_instance_row(int instance, int row)
{
  return texelFetch(ps_instances, ps_texel(instance * 4 + row), 0);
}

// Slopes of the ray through p, no steeper than those a little beyond the picture.
vec2 ps_slope(vec3 p)
{
  vec2 size = vec2(u.size);
  vec2 reach = PS_VIEW * max(abs(u.principal_point), abs(size - u.principal_point)) / abs(u.focal);
  return ps_is_perspective() ? clamp(p.xy / -p.z, -reach, reach) : vec2(0.0);
}

// Of a value on the position in the picture: covariance of that (xx, xy, yy), and with the value (x, y).
vec2 ps_regression(vec3 square, vec2 together)
{
  return vec2(square.z * together.x - square.y * together.y, square.x * together.y - square.y * together.x) /
         (square.x * square.z - square.y * square.y);
}

vec3 ps_cofactor(mat3 m, vec3 n)
{
  vec3 v = cross(m[1], m[2]) * n.x + cross(m[2], m[0]) * n.y + cross(m[0], m[1]) * n.z;
  return ps_direction(v, vec3(0.0));
}

void main()
{
  ivec2 here = ivec2(gl_FragCoord.xy);
  if (here.x + 4096 * here.y >= u.count) {
    discard;
  }
  vec2 entry = texelFetch(ps_order, here, 0).xy;
  int low = int(entry.x), high = int(entry.y);
  int instance = high >> 2;
  ivec2 at = ivec2(low & 4095, (low >> 12) + ((high & 3) << 12));

  // Half-axes in view space.
  vec4 head = texelFetch(ps_position, at, 0), extent = texelFetch(ps_extent, at, 0);
  vec4 optics = texelFetch(ps_optics, at, 0);
  vec4 rows[3] = vec4[3](ps_instance_row(instance, 0), ps_instance_row(instance, 1), ps_instance_row(instance, 2));
  vec4 q = vec4(head.xyz, 1.0);
  vec3 p = vec3(dot(rows[0], q), dot(rows[1], q), dot(rows[2], q));
  mat3 linear = transpose(mat3(rows[0].xyz, rows[1].xyz, rows[2].xyz));
  bool ball = head.w < 0.0, medium = optics.z > 0.5;
  vec3 n = ps_unpack_normal(max(head.w, 0.0)), major = ps_unpack_normal(extent.z);
  // Codes are rounded: perpendicular again.
  major = normalize(major - dot(major, n) * n);
  vec3 normal = ball ? vec3(0.0) : ps_cofactor(linear, n);
  vec3 facing = normal;
#ifdef PS_SHADING_NORMAL
  float code = texelFetch(ps_shading_normal, at, 0).x;
  facing = code >= 0.0 ? ps_cofactor(linear, ps_unpack_normal(code)) : medium ? vec3(0.0) : facing;
#else
  facing = medium ? vec3(0.0) : facing;
#endif

  // A medium that shines like a surface is steep there, and the lattice near it would show as rings.
  vec3 lit_position = p + (medium ? 3.0 * extent.x * length(linear[0]) * facing : vec3(0.0));
#ifdef PS_SHADOW_SPREAD
  // Of what fills a volume, many splats lie behind each other.
  bool pile = medium && dot(facing, facing) < 0.5;
  ps_spread = PsSpread(uint(at.x + 4096 * at.y), pile ? PS_POINTS_OF_MEDIUM : PS_EVERY_POINT);
#endif
#ifdef PS_REACH
  // How much of each light comes here does not depend on the camera.
  vec3 share[4] = vec3[4](vec3(1.0), vec3(1.0), vec3(1.0), vec3(1.0));
  for (int i = 0; i < PS_REACH; i++) {
    share[i] = ps_transmittance(i, lit_position, facing, true);
  }
#ifdef PS_REACH_COLORED
  out_reach_0 = vec4(share[0], 1.0);
#if PS_REACH > 1
  out_reach_1 = vec4(share[1], 1.0);
#endif
#if PS_REACH > 2
  out_reach_2 = vec4(share[2], 1.0);
#endif
#if PS_REACH > 3
  out_reach_3 = vec4(share[3], 1.0);
#endif
#else
  out_reach_0 = vec4(share[0].x, share[1].x, share[2].x, share[3].x);
#endif
#else
#ifdef PS_REACHED
#ifdef PS_REACHED_COLORED
  ps_reached[0] = texelFetch(ps_reach_0, at, 0).rgb;
#if PS_REACHED > 1
  ps_reached[1] = texelFetch(ps_reach_1, at, 0).rgb;
#endif
#if PS_REACHED > 2
  ps_reached[2] = texelFetch(ps_reach_2, at, 0).rgb;
#endif
#if PS_REACHED > 3
  ps_reached[3] = texelFetch(ps_reach_3, at, 0).rgb;
#endif
#else
  vec4 reached = texelFetch(ps_reach_0, at, 0);
  ps_reached = vec3[4](vec3(reached.x), vec3(reached.y), vec3(reached.z), vec3(reached.w));
#endif
#endif
  vec3 a = ball ? linear[0] * extent.x : linear * major * extent.x;
  vec3 b = ball ? linear[1] * extent.x : linear * cross(n, major) * extent.y;
  vec3 c = ball ? linear[2] * extent.x : linear * n * optics.y;
#ifdef PS_FUZZY
  bool fuzzy = optics.z < -0.5;
#ifdef PS_DEFOCUS
  float narrow_rim = 1.0;
#else
  float narrow_rim = fuzzy ? PS_FUZZY : 1.0;
#endif
  a *= narrow_rim;
  b *= narrow_rim;
  c *= narrow_rim;
#endif

  // Of what reaches before the near plane, the splat that has the moments of the part beyond: for a Gaussian, those of
  // the truncated normal distribution, and as many optical depths as are left.
  vec3 deep = -0.5 * vec3(a.z, b.z, c.z);
  float spread = max(length(deep), 1e-20), inside = (-p.z - u.near) / spread, beyond = 1.0;
  if (inside < PS_RIM_SIGMA && inside > -PS_RIM_SIGMA) {
    float share = ps_below(inside);
    float hazard = 0.39894228 * exp(-0.5 * inside * inside) / share;
    float narrow = sqrt(clamp(1.0 - hazard * (inside + hazard), 0.01, 1.0));
    vec3 weight = deep / spread;
    vec3 along = 0.5 * (a * weight.x + b * weight.y + c * weight.z);
    p += hazard * along;
    along *= 2.0 * (1.0 - narrow);
    a -= along * weight.x;
    b -= along * weight.y;
    c -= along * weight.z;
    beyond = share / narrow;
  }

  // Covariance in pixels, and with depth (Zwicker et al. 2001).
  float d = -p.z;
  vec2 slope = ps_slope(p);
  vec2 scale = 0.5 * u.focal * (ps_is_perspective() ? 1.0 / d : 1.0);
  vec2 ua = scale * (a.xy + slope * a.z), ub = scale * (b.xy + slope * b.z), uc = scale * (c.xy + slope * c.z);
  vec3 own = vec3(ua.x * ua.x + ub.x * ub.x + uc.x * uc.x, ua.x * ua.y + ub.x * ub.y + uc.x * uc.y,
                  ua.y * ua.y + ub.y * ub.y + uc.y * uc.y);
  // What is widened hides more, the deeper it is: only particles are, which would flicker. Voxels and samples of surfaces
  // add up evenly, and what they let through is right in the mean of all samples; wide needles must keep an inverse.
  float low_pass = optics.z == PS_PARTICLE ? PS_LOW_PASS : max(PS_LOW_PASS * u.low_pass_scale, 1e-4 * (own.x + own.z));
#ifdef PS_CENTRES
  low_pass = max(PS_PIXEL, low_pass);
#endif
#ifdef PS_DEFOCUS
  // A sample stands for a pixel, and each splat for all that the lens makes of it.
  float confusion = ps_confusion(d);
  low_pass = max(PS_DEFOCUS_PIXEL, low_pass);
  vec2 half_disk = confusion * vec2(u.aperture_aspect, 1.0);
  vec2 lean = ball || medium ? vec2(0.0) : half_disk * ps_lean(p, normal);
  vec3 disk = vec3(0.25 * half_disk.x * half_disk.x - lean.x * lean.x, -lean.x * lean.y,
                   0.25 * half_disk.y * half_disk.y - lean.y * lean.y);
  vec3 wide = own + vec3(low_pass, 0.0, low_pass) + disk;
#else
  vec3 wide = own + vec3(low_pass, 0.0, low_pass);
#endif
  float det = wide.x * wide.z - wide.y * wide.y;
  float kept = sqrt(max(own.x * own.z - own.y * own.y, 0.0) / det);

  // Optical depth along the ray through the centre. A medium's: extinction times 16 / 3 standard deviations along the
  // ray, in the object's units; a shell's does not depend on the angle.
  float peak = 2.0 * optics.x, strength = optics.x;
#ifdef PS_MEDIA
  if (medium) {
    float unit = max(max(length(a), length(b)), length(c));
    mat3 half_axes = mat3(a, b, c) / (2.0 * unit);
    vec3 ray = normalize(vec3(slope, -1.0));
    float along = unit / length(inverse(half_axes) * ray);
    float shrink = pow(abs(dot(linear[0], cross(linear[1], linear[2]))), 1.0 / 3.0);
    float path = (16.0 / 3.0) * along / shrink;
#ifdef PS_EMISSION
    strength = max(strength, PS_FAINT / path);
#endif
    peak = strength * path;
  }
#endif
  peak *= beyond;
  vec3 tint = vec3(1.0);
#ifdef PS_TINT
  tint = max(texelFetch(ps_tint, at, 0).rgb, medium ? PS_FAINT_TINT : 0.0);
#endif

  // Outside of the picture?
  vec2 centre = u.focal * p.xy * (ps_is_perspective() ? 1.0 / d : 1.0);
#ifdef PS_DEFOCUS
  vec2 beside = d * u.inverse_focus_distance < 1.0 ? -lean : lean;
  centre += beside;
#endif
  vec2 margin = PS_RIM_SIGMA * sqrt(wide.xz) + 2.0;
  vec2 pixel = centre + u.principal_point;
  bool seen = d > u.near && d < u.far && all(greaterThan(pixel + margin, vec2(0.0))) &&
              all(lessThan(pixel - margin, vec2(u.size))) && peak >= 0.0 && peak < 1e30 && det < 1e30;
#ifdef PS_CULL
  bool back = dot(normal, ps_is_perspective() ? p : vec3(0.0, 0.0, -1.0)) > 0.0;
  seen = seen && !(fuzzy && back && texelFetch(ps_materials, ivec2(2, int(extent.w + 0.5)), 0).x > 0.5);
#endif

  // Light.
  int material = int(extent.w + 0.5);
  vec3 to_eye = ps_is_perspective() ? normalize(-p) : vec3(0.0, 0.0, 1.0);
#ifdef PS_PLACES
  bool receives = seen && (!medium || dot(facing, facing) > 0.5);
  facing = dot(facing, facing) > 0.5 ? facing : to_eye;
  bool shows_back = dot(ball || medium ? facing : normal, to_eye) < 0.0;
  facing = shows_back ? -facing : facing;
  vec4 look = texelFetch(ps_materials, ivec2(2, material), 0);
#ifdef PS_SURFACE
  float roughness = texelFetch(ps_surface, at, 0).x;
#else
  float roughness = look.z > 0.0 || look.w != 1.0 ? look.y : -1.0;
#endif
#ifdef PS_STRANDS
  if (optics.z < -0.5 && optics.w > 0.5) {
    vec3 along = normalize(a), outward = to_eye - dot(to_eye, along) * along;
    facing = normalize(dot(outward, outward) > 1e-12 ? outward : to_eye);
    roughness = roughness < 0.0 ? -4.0 : -2.0 - roughness;
    shows_back = false;
  }
#endif
  out_place = vec4(mat3(u.tree_from_view) * lit_position, receives ? (shows_back ? -d : d) : 0.0);
  out_up = vec4(mat3(u.tree_from_view) * facing, roughness);
#else
  PsSurface surface = ps_material(material);
#ifdef PS_COLOR
  surface.base = texelFetch(ps_color, at, 0).rgb;
#endif
#ifdef PS_SURFACE
  vec2 rough = texelFetch(ps_surface, at, 0).xy;
  surface.roughness = rough.x;
  surface.metallic = rough.y;
#endif
  vec3 emission = vec3(0.0);
#ifdef PS_EMISSION
  emission = texelFetch(ps_emission, at, 0).rgb;
#endif
  bool lit_as_surface = !medium || dot(facing, facing) > 0.5;
  vec3 source = vec3(0.0);
#ifdef PS_MEDIA
  if (!lit_as_surface) {
    vec3 across = optics.z > 1.5 ? peak * PS_VOXEL_DEPTH * tint : vec3(0.0);
    source = ps_shade_medium(p, to_eye, texelFetch(ps_materials, ivec2(1, material), 0).w, surface.base, across, u.light_count);
  }
#ifdef PS_SHOWS_EMISSION
  // What emits per unit of length has this radiance where it is opaque.
  source += medium ? emission / (strength * tint) : vec3(0.0);
#endif
#endif
  surface.emission = medium ? vec3(0.0) : emission;
#ifdef PS_INDIRECT
  ps_gathered = texelFetch(ps_gathered_light, here, 0);
  ps_mirrored = texelFetch(ps_mirrored_light, here, 0);
#endif
  if (lit_as_surface) {
    facing = dot(facing, facing) > 0.5 ? facing : to_eye;
    facing = dot(ball || medium ? facing : normal, to_eye) < 0.0 ? -facing : facing;
#ifdef PS_STRANDS
    bool strand = fuzzy && optics.w > 0.5;
    for (int i = 0; i < (strand ? 1 : 0); i++) {
      source += ps_shade_strand(lit_position, normalize(a), to_eye, surface, texelFetch(ps_materials, ivec2(3, material), 0),
                                u.light_count);
    }
    for (int i = 0; i < (strand ? 0 : 1); i++) {
      source += ps_shade(lit_position, facing, vec3(0.0), to_eye, surface, u.light_count);
    }
#else
    source += ps_shade(lit_position, facing, vec3(0.0), to_eye, surface, u.light_count);
#endif
  }

#ifdef PS_SHADED
  source *= texelFetch(ps_shaded, at, 0).rgb;
#endif
#if defined(PS_FOG) && !defined(PS_REACH)
  source = ps_in_fog(source, p, pixel, u.light_count);
#endif

#ifdef PS_FUZZY_DISCONNECTED
  // What stands apart hides as much as if it were not widened: core/splat/painter.py, `thinned`.
  if (fuzzy && extent.y < 0.0) {
    float deepest = peak * PS_PEAK, most = 1.0 - PS_GAMMA * pow(deepest, -0.25);
    float g2 = PS_GAMMA * PS_GAMMA, whole = PS_GAMMA / (1.0 - most * kept);
    float thin = whole * whole * whole * whole - g2 * g2 * pow(max(1.0 - kept, 0.0), (5.0 / (g2 * g2) - 4.0) * most);
    kept = max(thin, 0.0) / deepest;
  }
#endif

#if defined(PS_AMONG_OPAQUE) || defined(PS_DEFOCUS)
  // Regression of depth on the position in the picture.
#ifdef PS_DEFOCUS
  vec3 seen_as = wide - disk;
#else
  // Of surfaces by their own plane, however they are widened, so that what lies close behind them is behind all of them.
  float even = 1e-4 * (own.x + own.z) + 1e-12;
  vec3 seen_as = medium ? wide : own + vec3(even, 0.0, even);
#endif
  deep = -0.5 * vec3(a.z, b.z, c.z);
  vec2 together = deep.x * ua + deep.y * ub + deep.z * uc;
  vec2 gradient = ps_regression(seen_as, together);
#endif
#ifdef PS_DEFOCUS
  float covers = 12.566371 * sqrt(max(own.x * own.z - own.y * own.y, 0.0));
  float amount = 0.5 * peak * covers, kind = PS_DEFOCUS_TRANSLUCENT;
#ifdef PS_FUZZY
  if (fuzzy) {
    amount = covers * texelFetch(ps_share, at, 0).x * (1.0 - ps_sharp(confusion));
    bool turned = !ball && dot(normal, ps_is_perspective() ? p : vec3(0.0, 0.0, -1.0)) > 0.0;
    kind = extent.y < 0.0 || optics.w > 0.5 ? PS_DEFOCUS_DISCONNECTED : turned ? PS_DEFOCUS_BACK : 0.0;
  }
#endif
  bool of_surface = kind <= PS_DEFOCUS_BACK || (kind == PS_DEFOCUS_TRANSLUCENT && !medium);
  float k = ps_defocus_exponent((disk.x + disk.z) / (wide.x + wide.z), of_surface);
#ifdef PS_HOLDOUT
  kind += ps_instance_row(instance, 3).x > 0.5 ? PS_DEFOCUS_HOLDOUT : 0.0;
#endif
  // How far before and behind its middle the surface may lie that it shows in a pixel: as far as its plane reaches, and
  // its neighbours do, within the disk.
  float reach = length(gradient) * sqrt(2.0 * (k + 2.0) * max(wide.x, wide.z)) + 2.0 * length(deep);
  out_centre = seen ? vec4(centre, d, amount * ps_defocus_peak(k, det)) : vec4(0.0);
  out_shape = seen ? vec4(vec3(wide.z, -wide.y, wide.x) / det, k + kind) : vec4(1.0, 0.0, 1.0, 0.0);
  out_source = vec4(ps_finite(source), reach);
#ifdef PS_SLOPES
  // No farther than the flat piece of surface in which it lies: what is round turns away.
  float thin = 1e-4 * (own.x + own.z) + 1e-12, flat_piece = texelFetch(ps_span, at, 0).x * sqrt(own.x + own.z);
  float shown = sqrt(2.0 * (k + 2.0) * max(wide.x, wide.z));
  out_slope = vec4(ps_regression(own + vec3(thin, 0.0, thin), together) * min(1.0, flat_piece / shown), beside);
#endif
#else
  out_centre = seen ? vec4(centre, d, peak * kept * PS_PEAK) : vec4(0.0);
  out_shape = seen ? vec4(wide, 0.0) : vec4(1.0, 0.0, 1.0, 0.0);
  out_source = vec4(ps_finite(source), 0.0);
#ifdef PS_KERNELS
  out_source.w = optics.w;
#endif
#ifdef PS_HOLDOUT
  if (ps_instance_row(instance, 3).x > 0.5) {
    out_source = vec4(0.0, 0.0, 0.0, -1.0 - out_source.w);
  }
#endif
#ifdef PS_AMONG_OPAQUE
  // And what it leaves of the variance.
  float variance = max(dot(deep, deep) - dot(gradient, together), 1e-10 * d * d);
  out_front = vec4(sqrt(variance), gradient, 0.0);
#endif
#endif
#ifdef PS_TINT
  out_tint = vec4(tint, 0.0);
#endif
#endif
#endif
}
