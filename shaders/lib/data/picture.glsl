// Baked pictures of materials over the unit square of UVs: core/material/baking.py. PS_UV: there are some.

#ifdef PS_UV
#ifndef PS_PICTURE_BORDER
// Of texels up to one beyond the unit square, or beyond two where pictures are mirrored: those within that show the same.
// Software renderers divide integers one by one.
ivec2 ps_inside(ivec2 texel, ivec2 size)
{
#ifdef PS_PICTURE_MIRROR
  texel = max(texel, ivec2(0));
  texel = ivec2(texel.x < size.x ? texel.x : 2 * size.x - 1 - texel.x, texel.y < size.y ? texel.y : 2 * size.y - 1 - texel.y);
  return max(texel, ivec2(0));
#else
  texel = ivec2(texel.x < 0 ? texel.x + size.x : texel.x, texel.y < 0 ? texel.y + size.y : texel.y);
  return ivec2(texel.x < size.x ? texel.x : texel.x - size.x, texel.y < size.y ? texel.y : texel.y - size.y);
#endif
}
#endif

// Where a picture over the unit square holds what lies at a texel inside or beyond it. PS_PICTURE_BORDER: it has so many texels
// around it, of which the last go on. PS_PICTURE_MIRROR: it is mirrored. Otherwise it repeats.
ivec2 ps_picture_texel(ivec2 texel, ivec2 size)
{
#if defined(PS_PICTURE_BORDER)
  return clamp(texel + PS_PICTURE_BORDER, ivec2(0), size + 2 * PS_PICTURE_BORDER - 1);
#else
  return ps_inside(texel, size);
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

// Within the unit square, or as far beyond it as a texel may lie whose number stays small.
vec2 ps_wrapped(vec2 uv)
{
#if defined(PS_PICTURE_BORDER)
  return clamp(uv, vec2(-8.0), vec2(9.0));
#elif defined(PS_PICTURE_MIRROR)
  return uv - 2.0 * floor(0.5 * uv);
#else
  return uv - floor(uv);
#endif
}

// A baked picture, interpolated as its images are: core/material/baking.py. PS_PICTURE_CLOSEST: not at all.
vec4 ps_picture(sampler2D picture, vec2 uv)
{
  ivec2 size = ps_picture_size(picture);
  uv = ps_wrapped(uv);
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
