// What a polygon's material is at a point of it. The including shader knows the point's v_uv, v_color, v_surface and
// v_emission, as varyings or as globals.

#include "lib/geometry/surfel.glsl"
#include "lib/data/pack.glsl"

#ifdef PS_UV
vec4 ps_repeat(sampler2D picture, vec2 uv)
{
  ivec2 size = textureSize(picture, 0);
  vec2 p = (uv - floor(uv)) * vec2(size) - 0.5;
  ivec2 low = ivec2(floor(p));
  vec2 f = p - vec2(low);
  ivec2 a = (low + size) % size;
  ivec2 b = (low + 1) % size;
  return mix(mix(texelFetch(picture, a, 0), texelFetch(picture, ivec2(b.x, a.y), 0), f.x),
             mix(texelFetch(picture, ivec2(a.x, b.y), 0), texelFetch(picture, b, 0), f.x), f.y);
}
#endif

#ifdef PS_BAKED_NORMAL
// The tangent frame from how position (px, py) and UV (ux, uy) change along two directions, since meshes carry no tangents
// here.
vec3 ps_bent(vec3 n, vec3 tangent_space, vec3 px, vec3 py, vec2 ux, vec2 uy)
{
  // Tangents stay where they are, whichever side of the triangle n is on.
  tangent_space.xy *= dot(cross(px, py), n) < 0.0 ? -1.0 : 1.0;
  vec3 t = cross(py, n) * ux.x + cross(n, px) * uy.x;
  vec3 b = cross(py, n) * ux.y + cross(n, px) * uy.y;
  float size = inversesqrt(max(max(dot(t, t), dot(b, b)), 1e-30));
  return normalize(t * size * tangent_space.x + b * size * tangent_space.y + n * tangent_space.z);
}
#endif

#ifdef PS_NORMAL
// Turns the normal to the side of the triangle that is seen (Cycles' rule: not by the normal's own direction), and keeps the
// triangle's plane. `turned`: the eye sees the side where `plane` does not point.
void ps_seen_from(inout PsSurfel s, vec3 plane, bool turned)
{
  float side = turned ? -1.0 : 1.0;
  s.normal.xyz *= side;
  s.centre.z = 1.0 + ps_pack_normal(side * plane);
}
#endif

// Whether the material has a hole there.
bool ps_see_through()
{
  bool hole = false;
#ifdef PS_BAKED_ALPHA
  hole = ps_repeat(ps_baked_color, v_uv).a < 0.5;
#endif
#ifdef PS_CORNER_ALPHA
  hole = hole || v_color.a < 0.5;
#endif
  return hole;
}

void ps_polygon_attributes(inout PsSurfel s)
{
#ifdef PS_COLOR
#if defined(PS_BAKED_COLOR)
  s.color.rgb = ps_repeat(ps_baked_color, v_uv).rgb;
#elif defined(PS_CORNER_COLOR)
  s.color.rgb = v_color.rgb;
#else
  s.color.rgb = texelFetch(ps_materials, ivec2(0, u.material), 0).rgb;
#endif
#endif
#ifdef PS_SURFACE
#if defined(PS_BAKED_SURFACE)
  vec2 surface = ps_repeat(ps_baked_surface, v_uv).xy;
#elif defined(PS_CORNER_SURFACE)
  vec2 surface = v_surface;
#else
  vec2 surface = texelFetch(ps_materials, ivec2(2, u.material), 0).yz;
#endif
  s.normal.w = surface.x;
  s.color.w = surface.y;
#endif
#ifdef PS_EMISSION
#if defined(PS_BAKED_EMISSION)
  s.emission = vec4(ps_repeat(ps_baked_emission, v_uv).rgb, 0.0);
#elif defined(PS_CORNER_EMISSION)
  s.emission = vec4(v_emission, 0.0);
#else
  s.emission = vec4(texelFetch(ps_materials, ivec2(1, u.material), 0).rgb, 0.0);
#endif
#endif
}
