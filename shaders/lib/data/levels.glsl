// Pictures filtered over footprints: PS_LEVELS. What a footprint holds of a texel or more is read from smaller levels
// (Williams 1983; core/material/levels.py), at a few places along its longer axis (McCormack et al. 1999). The reference
// is tests/reference/textures.py. Software renderers take both sides of a branch, but leave loops that none of their pixels
// needs.

#include "lib/data/picture.glsl"
#include "lib/data/patch.glsl"

#ifdef PS_LEVELS

#define PS_MOST_TAPS 8.0  // along the longer axis: narrower footprints are widened

// Of what reads a picture; the shader sets it before it asks for attributes.
struct PsFootprint {
  vec2 step;  // of UV, from tap to tap along the longer axis
  int taps;
  float level;  // binary logarithm of the texels that a tap spans; 0: it is magnified
  vec2 width;  // texels along u and v that a tap spans, at most 1
};
PsFootprint v_footprint;

// Of parallelograms with these sides in UV, of a picture of so many texels.
PsFootprint ps_footprint(vec2 side_a, vec2 side_b, vec2 texels)
{
  vec2 a = clamp(side_a, -8.0, 8.0) * texels, b = clamp(side_b, -8.0, 8.0) * texels;
  float xx = a.x * a.x + b.x * b.x, yy = a.y * a.y + b.y * b.y, xy = a.x * a.y + b.x * b.y;
  float mean = 0.5 * (xx + yy), apart = 0.5 * (xx - yy), root = sqrt(apart * apart + xy * xy);
  float longer = sqrt(mean + root), shorter = max(sqrt(max(mean - root, 0.0)), longer / PS_MOST_TAPS);
  vec2 along = apart > 0.0 ? vec2(apart + root, xy) : vec2(xy, root - apart);
  along *= inversesqrt(max(dot(along, along), 1e-30));
  float taps = clamp(floor(longer / max(shorter, 1.0) + 0.5), 1.0, PS_MOST_TAPS);
  PsFootprint found;
  found.taps = int(taps);
  found.step = along * longer / (taps * texels);
  found.level = 0.5 * log2(max(max(shorter, 1.0) * max(longer / taps, 1.0), 1.0));
  vec2 along_tap = along * longer / taps, across = vec2(-along.y, along.x) * shorter;
  found.width = clamp(abs(along_tap) + abs(across), vec2(1e-3), vec2(1.0));
  return found;
}

#define PS_OF_PATCH 0.25  // of a triangle's extent, which a footprint spans at most

// The side of a footprint, at most that wanted, and well within its triangle: beyond it a picture may hold something else, as
// where leaves smaller than that lie side by side. `uv_from_pixel`: changes of UV. `patch_area`: of the triangle in UV.
float ps_footprint_side(float wanted, mat2 uv_from_pixel, float patch_area)
{
  return min(wanted, PS_OF_PATCH * sqrt(patch_area / max(abs(determinant(uv_from_pixel)), 1e-30)));
}

// Of the shader's own pixel, which may be a cell.
PsFootprint ps_pixel_footprint(vec2 uv, float patch_area, float wanted, vec2 texels)
{
  mat2 uv_from_pixel = mat2(dFdx(uv), dFdy(uv));
  float side = ps_footprint_side(wanted, uv_from_pixel, patch_area);
  return ps_footprint(side * uv_from_pixel[0], side * uv_from_pixel[1], texels);
}

ivec2 ps_level_size(ivec2 size, int level)
{
  return max(size >> level, ivec2(1));
}

// Texels that a level of this size takes.
int ps_level_length(ivec2 size)
{
#ifdef PS_PICTURE_BORDER
  return (size.x + 2) * (size.y + 2);
#else
  return size.x * size.y;
#endif
}

// A texel of a level of this size that begins at `first`, inside or beyond the unit square.
vec4 ps_level_texel(sampler2D levels, int first, ivec2 texel, ivec2 size)
{
#if defined(PS_PICTURE_BORDER)
  texel = clamp(texel + 1, ivec2(0), size + 1);
  int i = first + texel.y * (size.x + 2) + texel.x;
#else
  texel = ps_inside(texel, size);
  int i = first + texel.y * size.x + texel.x;
#endif
  return texelFetch(levels, ivec2(i & 4095, i >> 12), 0);
}

vec4 ps_level(sampler2D levels, int first, ivec2 size, vec2 uv)
{
  vec2 p = uv * vec2(size) - 0.5, f = p - floor(p);
  ivec2 a = ivec2(floor(p)), b = a + 1;
  return mix(mix(ps_level_texel(levels, first, a, size), ps_level_texel(levels, first, ivec2(b.x, a.y), size), f.x),
             mix(ps_level_texel(levels, first, ivec2(a.x, b.y), size), ps_level_texel(levels, first, b, size), f.x), f.y);
}

// The sum over some taps from `at` on, of two levels of which the coarser one has the share of the fraction of `level`.
vec4 ps_levels(sampler2D levels, ivec2 size, vec2 at, vec2 step, int taps, float level)
{
  int top = findMSB(max(size.x, size.y)), k = clamp(int(level), 1, top), first = 0;
  for (int j = 1; j < k; j++) {
    first += ps_level_length(ps_level_size(size, j));
  }
  vec4 sum = vec4(0.0);
  float share = k < top ? 1.0 - clamp(level - float(k), 0.0, 1.0) : 1.0;
  for (int i = 0, reads = taps > 0 && share < 1.0 ? 2 * taps : taps; i < reads; i++) {
    ivec2 s = ps_level_size(size, k);
    sum += share * ps_level(levels, first, s, ps_wrapped(at));
    at += step;
    if (i == taps - 1) {
      first += ps_level_length(s);
      k++;
      share = 1.0 - share;
      at -= float(taps) * step;
    }
  }
  return sum;
}

#ifdef PS_PICTURE_CLOSEST
// Of texels that are not interpolated: decoded, the mean over a box of this width, at most a texel, around `uv`.
vec4 ps_picture_box(sampler2D picture, vec2 uv, vec2 width, bool encoded, bool associated, bool weighted)
{
  ivec2 size = ps_picture_size(picture);
  vec2 p = ps_wrapped(uv) * vec2(size) - 0.5;
  vec2 f = clamp((p - floor(p) - 0.5) / width + 0.5, 0.0, 1.0);
  vec4 sum = vec4(0.0);
  for (int i = 0; i < 4; i++) {
    ivec2 next = ivec2(i & 1, i >> 1);
    vec4 texel = texelFetch(picture, ps_picture_texel(ivec2(floor(p)) + next, size), 0);
    vec3 color = ps_picture_color(texel, encoded, associated);
    vec2 share = mix(1.0 - f, f, vec2(next));
    sum += share.x * share.y * vec4(weighted ? color * texel.a : color, texel.a);
  }
  return sum;
}
#endif

// A picture over the footprint at `uv`: decoded, the mean over taps; `weighted`: multiplied by alpha.
vec4 ps_filtered(sampler2D picture, sampler2D levels, vec2 uv, PsFootprint f, bool encoded, bool associated,
                 bool weighted)
{
  float share = clamp(f.level, 0.0, 1.0);  // of smaller levels
  int fine_taps = share < 1.0 ? f.taps : 0, coarse_taps = share > 0.0 ? f.taps : 0;
  vec2 first = uv - 0.5 * float(f.taps - 1) * f.step, at = first;
  vec4 fine = vec4(0.0);
  for (int i = 0; i < fine_taps; i++, at += f.step) {
#ifdef PS_PICTURE_CLOSEST
    fine += ps_picture_box(picture, at, f.width, encoded, associated, weighted);
#else
    vec4 texel = ps_picture(picture, at);
    vec3 color = ps_picture_color(texel, encoded, associated);
    fine += vec4(weighted ? color * texel.a : color, texel.a);
#endif
  }
  vec4 coarse = ps_levels(levels, ps_picture_size(picture), first, f.step, coarse_taps, f.level);
  return mix(fine, coarse, share) / float(f.taps);
}

#ifdef PS_ALPHA_WEIGHTS
#define PS_IS_WEIGHTED true
#else
#define PS_IS_WEIGHTED false
#endif

vec3 ps_filtered_color(sampler2D picture, sampler2D levels, vec2 uv, PsFootprint f, bool encoded, bool associated)
{
  vec4 found = ps_filtered(picture, levels, uv, f, encoded, associated, PS_IS_WEIGHTED);
  return PS_IS_WEIGHTED ? found.rgb / max(found.a, 1e-6) : found.rgb;
}

vec2 ps_filtered_surface(sampler2D picture, sampler2D levels, vec2 uv, PsFootprint f)
{
  return ps_filtered(picture, levels, uv, f, false, false, false).xy;
}

// Of the shader's own pixel, which is a cell that alpha cuts out at random: that of the nearest texel of about the footprint's length.
// Many cells are drawn over each other, and all of the footprint takes a software renderer five times as long.
float ps_cell_alpha(sampler2D picture, sampler2D levels, vec2 uv, float patch_area, float wanted)
{
  ivec2 size = ps_picture_size(picture);
  mat2 uv_from_pixel = mat2(dFdx(uv), dFdy(uv));
  float side = ps_footprint_side(wanted, uv_from_pixel, patch_area);
  vec2 a = uv_from_pixel[0] * vec2(size), b = uv_from_pixel[1] * vec2(size);
  float level = 0.5 * log2(max(side * side * max(dot(a, a), dot(b, b)), 1.0)) + 0.5;
  int k = min(int(level), findMSB(max(size.x, size.y))), first = 0;
  float alpha = 0.0;
  for (int i = k; i < 1; i++) {
    alpha = ps_picture(picture, uv).a;
  }
  for (int j = 1; j <= k; j++) {
    ivec2 s = ps_level_size(size, j);
    if (j == k) {
      alpha = ps_level_texel(levels, first, ivec2(floor(ps_wrapped(uv) * vec2(s))), s).a;
    }
    first += ps_level_length(s);
  }
  return alpha;
}

float ps_filtered_alpha(sampler2D picture, sampler2D levels, vec2 uv, PsFootprint f)
{
  return ps_filtered(picture, levels, uv, f, false, false, false).a;
}

#endif
