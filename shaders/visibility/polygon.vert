// Triangles of one material of one instance, corner by corner from textures. PS_PARTS: only those of the parts that
// `ps_parts` lists, each up to PS_PARTS corners.

#include "lib/geometry/camera.glsl"
#include "lib/geometry/direction.glsl"
#include "lib/data/pack.glsl"
#include "lib/data/patch.glsl"
#ifdef PS_CUT
#include "lib/visibility/cut.glsl"
#endif

ivec2 ps_texel(int index)
{
  return ivec2(index & 4095, index >> 12);
}

vec3 ps_turn(vec3 n)
{
  mat3 m = mat3(u.view_from_object);
  return cross(m[1], m[2]) * n.x + cross(m[2], m[0]) * n.y + cross(m[0], m[1]) * n.z;
}

void main()
{
#ifdef PS_PARTS
  vec4 part = texelFetch(ps_parts, ps_texel(gl_VertexID / PS_PARTS), 0);
  int corner_of_part = gl_VertexID % PS_PARTS;
  ivec2 texel = ps_texel((int(part.y) << 12) + int(part.x) + min(corner_of_part, int(part.z) - 1));
#else
  ivec2 texel = ps_texel(u.first + gl_VertexID);
#endif
  vec4 corner = texelFetch(ps_corner, texel, 0);
  v_position = (u.view_from_object * vec4(corner.xyz, 1.0)).xyz;
#ifdef PS_NORMAL
  v_normal = ps_direction(ps_turn(ps_unpack_normal(corner.w)), vec3(0.0, 0.0, 1.0));
#endif
#ifdef PS_UV
  v_uv = texelFetch(ps_corner_uv, texel, 0).xy;
#endif
#ifdef PS_LEVELS
  int first_corner = (texel.x + (texel.y << 12)) / 3 * 3;
  vec2 uv_first = texelFetch(ps_corner_uv, ps_texel(first_corner), 0).xy;
  v_patch = ps_patch_area(texelFetch(ps_corner_uv, ps_texel(first_corner + 1), 0).xy - uv_first,
                          texelFetch(ps_corner_uv, ps_texel(first_corner + 2), 0).xy - uv_first);
#endif
#ifdef PS_CORNER_COLOR
  v_color = texelFetch(ps_corner_color, texel, 0);
#endif
#ifdef PS_CORNER_SURFACE
  v_surface = texelFetch(ps_corner_surface, texel, 0).xy;
#endif
#ifdef PS_CORNER_EMISSION
  v_emission = texelFetch(ps_corner_emission, texel, 0).rgb;
#endif
#ifdef PS_CUT
  v_cut = ps_cut_of((texel.x + (texel.y << 12)) / 3, u.instance);
#endif
  gl_Position = ps_clip_from_view(v_position);
}
