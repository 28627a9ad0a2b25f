// Attributes of the triangle that stands for a group of sub-samples, where its sub-sample meets it: one texel of the
// G-buffer.

#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"
#include "lib/data/pack.glsl"
#include "lib/geometry/instance.glsl"
#include "lib/visibility/leader.glsl"

// The point, as lib/data/polygon.glsl wants it.
vec3 v_normal;
vec2 v_uv;
vec4 v_color;
vec2 v_surface;
vec3 v_emission;

#include "lib/data/polygon.glsl"

void main()
{
  PsLeader leader = ps_leader(ivec2(gl_FragCoord.xy));
  int number = leader.index - u.first_id, slot = number / u.triangles, triangle = number - slot * u.triangles;
  bool mine = triangle >= u.first_triangle && triangle < u.last_triangle;
  if (!leader.rasterised || number < 0 || slot >= u.slots || !mine) {
    discard;
  }
  ivec2 texels[3] = ivec2[3](ps_texel(3 * triangle), ps_texel(3 * triangle + 1), ps_texel(3 * triangle + 2));
  vec4 corners[3];
  vec3 p[3];
  for (int i = 0; i < 3; i++) {
    corners[i] = texelFetch(ps_corner, texels[i], 0);
    p[i] = ps_view_from_point(slot, corners[i].xyz);
  }
  // Weights of the corners from the point itself, which the rasteriser has found on the triangle.
  vec3 a = p[1] - p[0], b = p[2] - p[0], q = leader.position - p[0];
  float aa = dot(a, a), ab = dot(a, b), bb = dot(b, b);
  float det = aa * bb - ab * ab;
  vec2 w = det > 0.0 ? vec2(bb * dot(q, a) - ab * dot(q, b), aa * dot(q, b) - ab * dot(q, a)) / det : vec2(1.0 / 3.0);
  vec3 weights = clamp(vec3(1.0 - w.x - w.y, w), vec3(0.0), vec3(1.0));
  weights /= weights.x + weights.y + weights.z;
#ifdef PS_UV
  vec2 uv[3] = vec2[3](texelFetch(ps_corner_uv, texels[0], 0).xy, texelFetch(ps_corner_uv, texels[1], 0).xy,
                       texelFetch(ps_corner_uv, texels[2], 0).xy);
  v_uv = weights.x * uv[0] + weights.y * uv[1] + weights.z * uv[2];
#endif
#ifdef PS_CORNER_COLOR
  v_color = weights.x * texelFetch(ps_corner_color, texels[0], 0) + weights.y * texelFetch(ps_corner_color, texels[1], 0) +
            weights.z * texelFetch(ps_corner_color, texels[2], 0);
#endif
#ifdef PS_CORNER_SURFACE
  v_surface = weights.x * texelFetch(ps_corner_surface, texels[0], 0).xy +
              weights.y * texelFetch(ps_corner_surface, texels[1], 0).xy +
              weights.z * texelFetch(ps_corner_surface, texels[2], 0).xy;
#endif
#ifdef PS_CORNER_EMISSION
  v_emission = weights.x * texelFetch(ps_corner_emission, texels[0], 0).rgb +
               weights.y * texelFetch(ps_corner_emission, texels[1], 0).rgb +
               weights.z * texelFetch(ps_corner_emission, texels[2], 0).rgb;
#endif
  float material = float(u.material);
  PsSurfel s = ps_empty();
  s.centre = vec4(-leader.position.z, 0.0, 0.0, PS_POLYGON);
#ifdef PS_ONE_INSTANCE
  vec2 about = vec2(u.holdout, u.instance);
#else
  vec2 about = ps_instance_row(slot, 3).xy;
#endif
  s.shape = vec4(leader.offset, 0.0, about.x > 0.5 ? -1.0 - material : material);
#ifdef PS_NORMAL
  vec3 plane = ps_direction(cross(a, b), vec3(0.0, 0.0, 1.0));
  bool turned = dot(plane, ps_is_perspective() ? leader.position : vec3(0.0, 0.0, -1.0)) > 0.0;
  mat3 linear = ps_linear(slot);
  vec3 normal = vec3(0.0);
  for (int i = 0; i < 3; i++) {
    normal += weights[i] * ps_view_normal(linear, ps_unpack_normal(corners[i].w));
  }
  s.normal.xyz = ps_direction(normal, vec3(0.0, 0.0, 1.0));
#ifdef PS_BAKED_NORMAL
  s.normal.xyz = ps_bent(s.normal.xyz, ps_repeat(ps_baked_normal, v_uv).xyz, a, b, uv[1] - uv[0], uv[2] - uv[0]);
#endif
  ps_seen_from(s, plane, turned);
#endif
  ps_polygon_attributes(s);
#ifdef PS_OWNER
  s.owner = uint(about.y);
#endif
  ps_store(s);
}
