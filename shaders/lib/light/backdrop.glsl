// The world out of focus, drawn before by render/passes/shading/backdrop.py. u.backdrop_texels: its texels per pixel.

#ifdef PS_BACKDROP

vec3 ps_backdrop_at(vec2 pixel)
{
  vec2 at = pixel * u.backdrop_texels + 0.5;
  vec2 part = fract(at);
  ivec2 low = ivec2(floor(at)), last = textureSize(ps_backdrop, 0) - 1;
  ivec2 a = clamp(low, ivec2(0), last), b = clamp(low + 1, ivec2(0), last);
  vec3 below = mix(texelFetch(ps_backdrop, a, 0).rgb, texelFetch(ps_backdrop, ivec2(b.x, a.y), 0).rgb, part.x);
  vec3 above = mix(texelFetch(ps_backdrop, ivec2(a.x, b.y), 0).rgb, texelFetch(ps_backdrop, b, 0).rgb, part.x);
  return mix(below, above, part.y);
}

#endif
