// What a polygon's material is at a point of it. The including shader knows the point's v_uv, v_color, v_surface and
// v_emission, as varyings or as globals. PS_MATERIAL: the row of its material, where that is no uniform.

#include "lib/geometry/surfel.glsl"
#include "lib/data/pack.glsl"
#include "lib/geometry/direction.glsl"

#ifndef PS_MATERIAL
#define PS_MATERIAL u.material
#endif

#ifdef PS_UV
// Where a picture over the unit square holds what lies at a texel inside or beyond it. PS_PICTURE_BORDER: it has so many texels
// around it, of which the last go on. PS_PICTURE_MIRROR: it is mirrored. Otherwise it repeats.
ivec2 ps_picture_texel(ivec2 texel, ivec2 size)
{
#if defined(PS_PICTURE_BORDER)
  return clamp(texel + PS_PICTURE_BORDER, ivec2(0), size + 2 * PS_PICTURE_BORDER - 1);
#elif defined(PS_PICTURE_MIRROR)
  texel = (texel + 2 * size) % (2 * size);
  return min(texel, 2 * size - 1 - texel);
#else
  return (texel + size) % size;
#endif
}

// Of what lies over the unit square.
ivec2 ps_picture_size(sampler2D picture)
{
#ifdef PS_PICTURE_BORDER
  return textureSize(picture, 0) - 2 * PS_PICTURE_BORDER;
#else
  return textureSize(picture, 0);
#endif
}

// A baked picture, interpolated as its images are: core/material/baking.py. PS_PICTURE_CLOSEST: not at all.
vec4 ps_picture(sampler2D picture, vec2 uv)
{
  ivec2 size = ps_picture_size(picture);
#if defined(PS_PICTURE_BORDER)
  uv = clamp(uv, vec2(-8.0), vec2(9.0));  // numbers of texels stay small
#elif defined(PS_PICTURE_MIRROR)
  uv -= 2.0 * floor(0.5 * uv);
#else
  uv -= floor(uv);
#endif
#ifdef PS_PICTURE_CLOSEST
  return texelFetch(picture, ps_picture_texel(ivec2(floor(uv * vec2(size))), size), 0);
#else
  vec2 p = uv * vec2(size) - 0.5;
  vec2 f = p - floor(p);
  ivec2 a = ps_picture_texel(ivec2(floor(p)), size), b = ps_picture_texel(ivec2(floor(p)) + 1, size);
  return mix(mix(texelFetch(picture, a, 0), texelFetch(picture, ivec2(b.x, a.y), 0), f.x),
             mix(texelFetch(picture, ivec2(a.x, b.y), 0), texelFetch(picture, b, 0), f.x), f.y);
#endif
}

// The colour that a texel holds: encoded with the sRGB curve, multiplied by alpha, both or neither.
vec3 ps_picture_color(vec4 texel, bool encoded, bool associated)
{
  vec3 color = associated && texel.a > 0.0 ? texel.rgb / texel.a : texel.rgb;
  vec3 high = pow((max(color, vec3(0.0)) + 0.055) / 1.055, vec3(2.4));
  return encoded ? mix(high, color / 12.92, lessThan(color, vec3(0.04045))) : color;
}
#endif

#ifdef PS_ENCODED_COLOR
#define PS_COLOR_IS_ENCODED true
#else
#define PS_COLOR_IS_ENCODED false
#endif
#ifdef PS_ASSOCIATED_COLOR
#define PS_COLOR_IS_ASSOCIATED true
#else
#define PS_COLOR_IS_ASSOCIATED false
#endif
#ifdef PS_ENCODED_EMISSION
#define PS_EMISSION_IS_ENCODED true
#else
#define PS_EMISSION_IS_ENCODED false
#endif
#ifdef PS_ASSOCIATED_EMISSION
#define PS_EMISSION_IS_ASSOCIATED true
#else
#define PS_EMISSION_IS_ASSOCIATED false
#endif

#ifdef PS_BAKED_NORMAL
// The tangent along growing u, from how position (px, py) and UV (ux, uy) change along two directions, since meshes carry no
// tangents here; as in Cycles tangent and bitangent are of unit length, however pictures are stretched.
vec3 ps_bent(vec3 n, vec3 tangent_space, vec3 px, vec3 py, vec2 ux, vec2 uy)
{
  float area = ux.x * uy.y - ux.y * uy.x;
  float sense = area * dot(cross(px, py), n) < 0.0 ? -1.0 : 1.0;
  vec3 t = ps_direction(area == 0.0 ? px : (px * uy.y - py * ux.y) * sign(area), vec3(0.0));
  return ps_direction(t * tangent_space.x + sense * cross(n, t) * tangent_space.y + n * tangent_space.z, n);
}
#endif

#ifdef PS_BAKED_HEIGHT
// How the height of a baked picture, interpolated between its texels, changes along u and v, and the strength of the bump.
vec3 ps_slope(vec2 uv)
{
  ivec2 size = ps_picture_size(ps_baked_height);
#if defined(PS_PICTURE_BORDER)
  uv = clamp(uv, vec2(-8.0), vec2(9.0));
#elif defined(PS_PICTURE_MIRROR)
  uv -= 2.0 * floor(0.5 * uv);
#else
  uv -= floor(uv);
#endif
  vec2 p = uv * vec2(size) - 0.5, f = p - floor(p);
  ivec2 a = ps_picture_texel(ivec2(floor(p)), size), b = ps_picture_texel(ivec2(floor(p)) + 1, size);
  vec2 low = texelFetch(ps_baked_height, a, 0).xy, right = texelFetch(ps_baked_height, ivec2(b.x, a.y), 0).xy;
  vec2 above = texelFetch(ps_baked_height, ivec2(a.x, b.y), 0).xy, high = texelFetch(ps_baked_height, b, 0).xy;
  vec2 slope = vec2(mix(right.x - low.x, high.x - above.x, f.y), mix(above.x - low.x, high.x - right.x, f.x));
  return vec3(slope * vec2(size), mix(mix(low.y, right.y, f.x), mix(above.y, high.y, f.x), f.y));
}

// The normal n of a surface that is raised by the height at `uv` (Mikkelsen 2010), from how position (px, py) and UV (ux, uy)
// change along two directions. `side`: -1 where the surface is seen from behind, which is raised towards the eye too.
vec3 ps_raised(vec3 n, vec2 uv, float side, vec3 px, vec3 py, vec2 ux, vec2 uy)
{
  vec3 slope = ps_slope(uv);
  vec3 across = cross(py, n), along = cross(n, px);
  float d = dot(px, across);
  vec3 rise = (dot(slope.xy, ux) * across + dot(slope.xy, uy) * along) / (abs(d) > 0.0 ? d : 1e30);
  vec3 raised = ps_direction(n - side * rise, n);
  return ps_direction(mix(n, raised, max(slope.z, 0.0)), n);
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

#ifdef PS_CUT
// Of the material.
float ps_polygon_alpha()
{
#ifdef PS_BAKED_ALPHA
  return ps_picture(ps_baked_color, v_uv).a;
#else
  return v_color.a;
#endif
}
#endif

void ps_polygon_attributes(inout PsSurfel s)
{
#ifdef PS_COLOR
#if defined(PS_BAKED_COLOR)
  s.color.rgb = ps_picture_color(ps_picture(ps_baked_color, v_uv), PS_COLOR_IS_ENCODED, PS_COLOR_IS_ASSOCIATED);
#elif defined(PS_CORNER_COLOR)
  s.color.rgb = v_color.rgb;
#else
  s.color.rgb = texelFetch(ps_materials, ivec2(0, PS_MATERIAL), 0).rgb;
#endif
#endif
#ifdef PS_SURFACE
#if defined(PS_BAKED_SURFACE)
  vec2 surface = ps_picture(ps_baked_surface, v_uv).xy;
#elif defined(PS_CORNER_SURFACE)
  vec2 surface = v_surface;
#else
  vec2 surface = texelFetch(ps_materials, ivec2(2, PS_MATERIAL), 0).yz;
#endif
  s.normal.w = surface.x;
  s.color.w = surface.y;
#endif
#ifdef PS_EMISSION
#if defined(PS_BAKED_EMISSION)
  vec4 emission = ps_picture(ps_baked_emission, v_uv);
  s.emission = vec4(ps_picture_color(emission, PS_EMISSION_IS_ENCODED, PS_EMISSION_IS_ASSOCIATED), 0.0);
#elif defined(PS_CORNER_EMISSION)
  s.emission = vec4(v_emission, 0.0);
#else
  s.emission = vec4(texelFetch(ps_materials, ivec2(1, PS_MATERIAL), 0).rgb, 0.0);
#endif
#endif
}
