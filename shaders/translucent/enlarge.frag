// A coarse picture between its pixels' centres.
void main()
{
  ivec2 size = textureSize(ps_coarse, 0);
  vec2 at = 0.5 * gl_FragCoord.xy - 0.5;
  ivec2 low = ivec2(floor(at));
  vec2 share = at - vec2(low);
  ivec2 a = clamp(low, ivec2(0), size - 1), b = clamp(low + 1, ivec2(0), size - 1);
  out_color = mix(mix(texelFetch(ps_coarse, a, 0), texelFetch(ps_coarse, ivec2(b.x, a.y), 0), share.x),
                  mix(texelFetch(ps_coarse, ivec2(a.x, b.y), 0), texelFetch(ps_coarse, b, 0), share.x), share.y);
}
