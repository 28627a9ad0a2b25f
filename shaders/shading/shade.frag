// Deferred shading: the G-buffer to scene-linear radiance, premultiplied, added to what earlier samples left. Pixels
// that show nothing are left to background.frag. PS_AUXILIARY_ONLY: only passes beside Combined are drawn. PS_GROUPED: the
// texels are a list of groups of sub-samples, and shape.xy is where in the pixel the one lies that stands for the group.
// PS_FOOTPRINT: shadows are looked up at each of these sub-samples. PS_MATTES: some groups are mattes, which are left to
// PS_CATCHER, for which light is that of what was added to a capture. PS_BEHIND: what mattes let through. PS_BRIGHT: no shadow falls on them. PS_HITS: the texels
// are a list of what rays have met.

#include "lib/geometry/camera.glsl"
#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/visibility/surface_key.glsl"
#include "lib/geometry/surfel_kind.glsl"
#include "lib/data/pack.glsl"
#include "lib/light/lights.glsl"
#include "lib/fog/in_fog.glsl"
#ifdef PS_CATCHER
#include "lib/captured/lit.glsl"
#else
#include "lib/data/materials.glsl"
#endif
#include "lib/geometry/geometry.glsl"
#include "lib/geometry/finite.glsl"
#include "lib/geometry/coverage.glsl"
#ifdef PS_STRANDS
#include "lib/strands/hair.glsl"
#endif
#ifdef PS_GROUPED
#include "lib/visibility/listed.glsl"
#endif
#ifdef PS_FOCUS
#include "lib/splat/defocus.glsl"
#endif

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec4 centre = texelFetch(ps_centre, pixel, 0);
  float covered = ps_coverage(pixel, centre);
#ifdef PS_FOCUS
  // The rest is left to defocus/gather.frag.
  covered *= ps_sharp(ps_confusion(centre.x));
#endif
  if (covered == 0.0) {
    discard;
  }
  vec4 shape = texelFetch(ps_shape, pixel, 0);
#ifdef PS_CATCHER
  if (!ps_is_matte(shape)) {
    discard;
  }
#elif defined(PS_MATTES)
  if (ps_is_matte(shape)) {
    discard;
  }
#endif
#ifdef PS_GROUPED
  vec2 at = vec2(ps_listed(pixel).pixel) + 0.5 + shape.xy;
#else
  vec2 at = gl_FragCoord.xy;
#endif
#ifdef PS_SHADOW_SPREAD
  ps_spread = PsSpread(ps_strand_number(centre), ps_is_strand(centre) ? PS_POINTS_OF_STRAND : PS_EVERY_POINT);
#endif
#ifdef PS_FOOTPRINT
  PsListed listed = ps_listed(pixel);
  ps_footprint.middle = ps_central_cell(listed.pixel);
  uvec2 codes = uvec2(texelFetch(ps_first, listed.pixel, 0).x, texelFetch(ps_second, listed.pixel, 0).x);
  ps_footprint.members = ps_group_members(codes, uint(listed.layer));
  ps_footprint.keyed = !ps_is_strand(centre);
#ifdef PS_FOG
  ps_footprint.air = false;
#endif
  ps_footprint.turn = vec3(0.0);
  if (centre.z > 0.5) {
    // Normals of keys are interpolated over triangles: they are turned so that this one is the triangle's own.
    ivec2 leader = ivec2(floor(ps_cell_from_pixel(vec2(listed.pixel) + 0.5 + shape.xy)));
    vec3 shown = ps_key_normal(texelFetch(ps_keys, leader, 0).x), own = ps_unpack_normal(centre.z - 1.0);
    ps_footprint.turn = (dot(shown, own) < 0.0 ? -own : own) - shown;
  }
  ps_footprint.plane = ps_footprint.bulge = ps_footprint.raised = vec3(0.0);
  bool balls = centre.z <= PS_BALL;
  ps_footprint.above = balls ? PS_MAP_BIAS_OF_BALLS : PS_MAP_BIAS;
  ps_footprint.rise = balls ? (PS_BALL - centre.z) * ps_pixel_size(centre.x) : 0.0;
  ps_footprint.rise = ps_footprint.keyed ? ps_footprint.rise : PS_MAP_RISE_OF_STRANDS * ps_pixel_size(centre.x);
#endif
#ifdef PS_NORMAL
  vec4 bent = texelFetch(ps_normal, pixel, 0);
  vec3 normal = ps_surface_normal(bent.xyz, centre, shape, at);
  vec3 position = ps_surface_position(normal, bent.xyz, centre, at);
  bool own_pixel = centre.w <= PS_POLYGON, bends = own_pixel && centre.z > 0.5;
  vec3 plane = bends ? ps_unpack_normal(centre.z - 1.0) : vec3(0.0);
#ifdef PS_FOOTPRINT
  ps_footprint.plane = plane;
  ps_footprint.bulge = bends ? shape.z * ps_pixel_size(centre.x) * normal : vec3(0.0);
#endif
#else
  vec3 normal = vec3(0.0, 0.0, 1.0), plane = vec3(0.0);
  vec3 position = ps_view_from_pixel(at, centre.x);
#endif
#ifdef PS_HITS
  position = texelFetch(ps_hit_places, pixel, 0).xyz;
#endif
#ifdef PS_COARSE
  // A coarse node lies below the surface that it stands for, which casts shadows as fine as ever: it is lit above that.
  float radius = centre.w > PS_POLYGON ? 2.0 * max(abs(shape.x), length(shape.yz)) : 0.0;  // pixels
  position += normal * (radius * ps_pixel_size(centre.x));
#endif
#ifdef PS_HITS
  vec3 to_eye = -texelFetch(ps_hit_rays, pixel, 0).xyz;
#else
  vec3 to_eye = -ps_ray(at);
#endif
#ifdef PS_NORMAL
  normal *= own_pixel && !bends && dot(normal, to_eye) < 0.0 ? -1.0 : 1.0;
#endif
#ifdef PS_STRANDS
  bool strand = ps_is_strand(centre);
  vec3 tangent = normal;
  vec3 outward = to_eye - dot(to_eye, tangent) * tangent;
  normal = strand ? normalize(dot(outward, outward) > 1e-12 ? outward : to_eye) : normal;
#endif
#ifdef PS_CATCHER
  // What is behind it shows through, as dark as the shadows are that fall onto it.
#ifdef PS_BRIGHT
  const vec3 left = vec3(1.0);
#else
  vec3 left = ps_captured_light(position, normal, to_eye, u.light_count);
#endif
#ifdef PS_BEHIND
  vec4 behind = texelFetch(ps_behind, ps_listed(pixel).pixel, 0);
#else
  const vec4 behind = vec4(0.0);
#endif
  float hidden = 1.0 - dot(left, vec3(1.0 / 3.0));
  out_combined = vec4(behind.rgb * left, behind.a + (1.0 - behind.a) * hidden);
  out_matte = vec4(left, 1.0);
#else
  bool holdout = shape.w < -0.5;
  int material = int((holdout ? -1.0 - shape.w : shape.w) + 0.5);

  PsSurface surface = ps_material(material);
#ifdef PS_COLOR
  vec4 tint = texelFetch(ps_color, pixel, 0);
  surface.base = tint.rgb;
#endif
#ifdef PS_SURFACE
  surface.roughness = bent.w;
  surface.metallic = tint.w;
#endif
#ifdef PS_TANGENT
  ps_grain = texelFetch(ps_tangent, pixel, 0).xyz;
#endif
#ifdef PS_SPREAD
  surface.spread = centre.w <= PS_POLYGON ? max(centre.y, 0.0) : 0.0;
#endif
#ifdef PS_EMISSION
  surface.emission = texelFetch(ps_emission, pixel, 0).rgb;
#endif
#ifndef PS_AUXILIARY_ONLY
#ifdef PS_INDIRECT
  ps_gathered = texelFetch(ps_gathered_light, pixel, 0);
#ifndef PS_HITS  // for these light is gathered about their own normals
  if (plane != vec3(0.0)) {
    ps_gathered.rgb *= ps_gathering_normal(normal, plane, to_eye).w;
  }
#endif
  ps_mirrored = texelFetch(ps_mirrored_light, pixel, 0);
#endif
#ifdef PS_STRANDS
  // Loops of one turn or none, since some devices run both sides of every branch.
  vec3 radiance = vec3(0.0);
  for (int i = 0; i < (strand ? 0 : 1); i++) {
    radiance = ps_shade(position, normal, plane, to_eye, surface, u.light_count);
  }
  for (int i = 0; i < (strand ? 1 : 0); i++) {
    vec4 fibre = texelFetch(ps_materials, ivec2(3, material), 0);
    radiance = ps_shade_strand(position, tangent, to_eye, surface, fibre, u.light_count);
  }
#else
  vec3 radiance = ps_shade(position, normal, plane, to_eye, surface, u.light_count);
#endif
#ifdef PS_FOG
  radiance = ps_in_fog(radiance, position, at, u.light_count);
#endif
#ifdef PS_FOCUS
  out_focus = covered * vec4(centre.x, 1.0, 0.0, 0.0);
#endif
  out_combined = holdout ? vec4(0.0) : covered * vec4(ps_finite(radiance), 1.0);
#ifdef PS_CUT_OUT
  out_combined *= 1.0 - texelFetch(ps_materials, ivec2(9, material), 0).w;
#endif
#endif

#ifdef PS_OUT_NORMAL
  out_normal_pass = covered * vec4(mat3(u.world_from_view) * normal, 1.0);
#endif
#ifdef PS_OUT_MIST
  float d = ps_is_perspective() ? length(position) : -position.z;
  float mist = clamp((d - u.mist_start) * u.mist_scale, 0.0, 1.0);
  out_mist = vec4(covered * (u.mist_exponent == 1.0 ? mist : pow(mist, u.mist_exponent)));
#endif
#endif
}
