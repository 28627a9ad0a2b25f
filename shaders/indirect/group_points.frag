// Where the groups of a list are, and how they are turned, in the space of the light tree: one texel a group.
//   out_place: position; depth in the view, 0: no group
//   out_up: normal of the side that is seen; roughness, -1 where nothing is mirrored; of fibres, whose normal is that of their middle,
//     -2 less the roughness, and -4; of balls PS_OF_BALLS more
//   out_ray: PS_MIRRORS: where the eye is mirrored to; how far what the group stands for bulges above its plane

#include "lib/geometry/camera.glsl"
#include "lib/geometry/surfel_kind.glsl"
#include "lib/data/pack.glsl"
#include "lib/light/brdf.glsl"
#include "lib/data/materials.glsl"
#include "lib/geometry/geometry.glsl"
#include "lib/geometry/coverage.glsl"
#include "lib/visibility/listed.glsl"

#define PS_OF_BALLS 8.0

void main()
{
  ivec2 texel = ivec2(gl_FragCoord.xy);
  vec4 centre = texelFetch(ps_centre, texel, 0);
  if (ps_coverage(texel, centre) == 0.0) {
    discard;
  }
  vec4 shape = texelFetch(ps_shape, texel, 0);
  vec2 at = vec2(ps_listed(texel).pixel) + 0.5 + shape.xy;
  vec4 bent = texelFetch(ps_normal, texel, 0);
  vec3 normal = ps_surface_normal(bent.xyz, centre, shape, at);
  vec3 position = ps_surface_position(normal, bent.xyz, centre, at);
  vec3 to_eye = -ps_ray(at);
  if (ps_is_strand(centre)) {
    vec3 outward = to_eye - dot(to_eye, normal) * normal;
    normal = normalize(dot(outward, outward) > 1e-12 ? outward : to_eye);
  } else if (centre.w <= PS_POLYGON && centre.z <= 0.5 && dot(normal, to_eye) < 0.0) {
    normal = -normal;
  }
  if (centre.w <= PS_POLYGON && centre.z > 0.5) {
    normal = ps_gathering_normal(normal, ps_unpack_normal(centre.z - 1.0), to_eye).xyz;
  }
  float row = shape.w < -0.5 ? -1.0 - shape.w : shape.w;
  vec4 look = texelFetch(ps_materials, ivec2(2, int(row + 0.5)), 0);
#ifdef PS_SURFACE
  float roughness = bent.w;
  bool mirrors = true;
#else
  float roughness = look.y;
  bool mirrors = look.z > 0.0 || look.w != 1.0;
#endif
  roughness = ps_is_strand(centre) ? (mirrors ? -2.0 - roughness : -4.0) : mirrors ? roughness : -1.0;
  out_place = vec4(mat3(u.tree_from_view) * position, centre.x);
  bool is_ball = centre.w <= PS_POLYGON && !ps_is_strand(centre) && centre.z <= 0.5 * PS_BALL;
  out_up = vec4(mat3(u.tree_from_view) * normal, roughness + (is_ball ? PS_OF_BALLS : 0.0));
#ifdef PS_MIRRORS
  bool bends = centre.w <= PS_POLYGON && centre.z > 0.5;
  vec3 plane = bends ? ps_unpack_normal(centre.z - 1.0) : vec3(0.0);
  vec3 reflecting = ps_reflecting_normal(normal, plane, to_eye);
  vec3 ray = 2.0 * dot(reflecting, to_eye) * reflecting - to_eye;
  out_ray = vec4(mat3(u.tree_from_view) * ray, bends ? shape.z * ps_pixel_size(centre.x) : 0.0);
#endif
}
