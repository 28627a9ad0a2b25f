// What a polygon's material is at a point of it. The including shader knows the point's v_uv, v_color, v_surface and
// v_emission, as varyings or as globals. PS_MATERIAL: the row of its material, where that is no uniform.

#include "lib/geometry/surfel.glsl"
#include "lib/data/pack.glsl"
#include "lib/geometry/direction.glsl"
#include "lib/data/picture.glsl"
#include "lib/data/levels.glsl"

#ifndef PS_MATERIAL
#define PS_MATERIAL u.material
#endif

#if defined(PS_UV)
// Of the material's pictures, which are of one size.
vec2 ps_texels()
{
#if defined(PS_BAKED_COLOR) || defined(PS_BAKED_ALPHA)
  return vec2(ps_picture_size(ps_baked_color));
#elif defined(PS_BAKED_EMISSION)
  return vec2(ps_picture_size(ps_baked_emission));
#elif defined(PS_BAKED_SURFACE)
  return vec2(ps_picture_size(ps_baked_surface));
#elif defined(PS_BAKED_NORMAL)
  return vec2(ps_picture_size(ps_baked_normal));
#elif defined(PS_BAKED_HEIGHT)
  return vec2(ps_picture_size(ps_baked_height));
#else
  return vec2(1.0);
#endif
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
  vec2 p = ps_wrapped(uv) * vec2(size) - 0.5, f = p - floor(p);
  ivec2 a = ps_picture_texel(ivec2(floor(p)), size), b = ps_picture_texel(ivec2(floor(p)) + 1, size);
  vec2 low = texelFetch(ps_baked_height, a, 0).xy, right = texelFetch(ps_baked_height, ivec2(b.x, a.y), 0).xy;
  vec2 above = texelFetch(ps_baked_height, ivec2(a.x, b.y), 0).xy, high = texelFetch(ps_baked_height, b, 0).xy;
  vec2 slope = vec2(mix(right.x - low.x, high.x - above.x, f.y), mix(above.x - low.x, high.x - right.x, f.x));
  return vec3(slope * vec2(size), mix(mix(low.y, right.y, f.x), mix(above.y, high.y, f.x), f.y));
}

// Which ways a surface with the normal n tilts by slopes of 1 along u and v (Mikkelsen 2010), from how position (px, py) and
// UV (ux, uy) change along two directions.
mat2x3 ps_tilts(vec3 n, vec3 px, vec3 py, vec2 ux, vec2 uy)
{
  vec3 across = cross(py, n), along = cross(n, px);
  float d = dot(px, across);
  d = abs(d) > 0.0 ? d : 1e30;
  return mat2x3((ux.x * across + uy.x * along) / d, (ux.y * across + uy.y * along) / d);
}

// The normal n of a surface that is raised by a slope, of ps_slope. `side`: -1 where the surface is seen from behind, which is
// raised towards the eye too.
vec3 ps_raised(vec3 n, vec3 slope, float side, mat2x3 tilts)
{
  vec3 raised = ps_direction(n - side * (tilts * slope.xy), n);
  return ps_direction(mix(n, raised, max(slope.z, 0.0)), n);
}
#endif

#if defined(PS_LEVELS) && defined(PS_SPREAD) && defined(PS_BAKED_NORMAL)
// The mean over a footprint of what normals in a picture show, made unit: (x, y, 1 - z), which half floats hold of flat ones, too.
vec3 ps_filtered_normal(vec2 uv, PsFootprint f)
{
  float share = clamp(f.level, 0.0, 1.0);  // of smaller levels
  int fine_taps = share < 1.0 ? f.taps : 0, coarse_taps = share > 0.0 ? f.taps : 0;
  vec2 first = uv - 0.5 * float(f.taps - 1) * f.step, at = first;
  vec3 fine = vec3(0.0);
  for (int i = 0; i < fine_taps; i++, at += f.step) {
    vec3 n = ps_direction(ps_picture(ps_baked_normal, at).xyz, vec3(0.0, 0.0, 1.0));
    fine += vec3(n.xy, n.z > 0.0 ? dot(n.xy, n.xy) / (1.0 + n.z) : 1.0 - n.z);
  }
  ivec2 size = ps_picture_size(ps_baked_normal);
  vec3 coarse = ps_levels(ps_baked_normal_levels, size, first, f.step, coarse_taps, f.level).xyz;
  return mix(fine, coarse, share) / float(f.taps);
}
#endif

#if defined(PS_LEVELS) && defined(PS_SPREAD) && defined(PS_BAKED_HEIGHT)
// The mean over a footprint of slopes along u and v, and of their squares.
vec4 ps_filtered_slope(vec2 uv, PsFootprint f)
{
  float share = clamp(f.level, 0.0, 1.0);  // of smaller levels
  int fine_taps = share < 1.0 ? f.taps : 0, coarse_taps = share > 0.0 ? f.taps : 0;
  vec2 first = uv - 0.5 * float(f.taps - 1) * f.step, at = first;
  vec4 fine = vec4(0.0);
  for (int i = 0; i < fine_taps; i++, at += f.step) {
    vec2 slope = ps_slope(at).xy;
    fine += vec4(slope, slope * slope);
  }
  ivec2 size = ps_picture_size(ps_baked_height);
  vec4 coarse = ps_levels(ps_baked_height_levels, size, first, f.step, coarse_taps, f.level);
#ifdef PS_PICTURE_MIRROR
  coarse.xy *= 1.0 - 2.0 * mod(floor(uv), 2.0);  // heights fall there where they rise
#endif
  return mix(fine, coarse, share) / float(f.taps);
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
#if defined(PS_LEVELS)
  return ps_filtered_alpha(ps_baked_color, ps_baked_color_levels, v_uv, v_footprint);
#elif defined(PS_BAKED_ALPHA)
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
#elif defined(PS_CORNER_COLOR) || defined(PS_PLACED_COLOR)
  s.color.rgb = v_color.rgb;
#else
  s.color.rgb = texelFetch(ps_materials, ivec2(0, PS_MATERIAL), 0).rgb;
#endif
#endif
#ifdef PS_SURFACE
#if defined(PS_BAKED_SURFACE)
  vec2 surface = ps_picture(ps_baked_surface, v_uv).xy;
#elif defined(PS_CORNER_SURFACE) || defined(PS_PLACED_SURFACE)
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
#elif defined(PS_CORNER_EMISSION) || defined(PS_PLACED_EMISSION)
  s.emission = vec4(v_emission, 0.0);
#else
  s.emission = vec4(texelFetch(ps_materials, ivec2(1, PS_MATERIAL), 0).rgb, 0.0);
#endif
#endif
}

#ifdef PS_LEVELS
// What ps_polygon_attributes takes from pictures, over the footprint.
void ps_filtered_attributes(inout PsSurfel s)
{
#if defined(PS_COLOR) && defined(PS_BAKED_COLOR)
  s.color.rgb = ps_filtered_color(ps_baked_color, ps_baked_color_levels, v_uv, v_footprint, PS_COLOR_IS_ENCODED,
                                  PS_COLOR_IS_ASSOCIATED);
#endif
#if defined(PS_SURFACE) && defined(PS_BAKED_SURFACE)
  vec2 surface = ps_filtered_surface(ps_baked_surface, ps_baked_surface_levels, v_uv, v_footprint);
  s.normal.w = surface.x;
  s.color.w = surface.y;
#endif
#if defined(PS_EMISSION) && defined(PS_BAKED_EMISSION)
  s.emission = vec4(ps_filtered_color(ps_baked_emission, ps_baked_emission_levels, v_uv, v_footprint, PS_EMISSION_IS_ENCODED,
                                      PS_EMISSION_IS_ASSOCIATED), 0.0);
#endif
}
#endif
