// The farthest depth up to which splats belong to what `visibility` found (PS_FIRST: in four pixels, u.step pixels
// from the next four), or in four windows, u.step texels apart. Where nothing was found it is PS_OPEN.

#define PS_OPEN 3e38

void main()
{
  ivec2 at = ivec2(gl_FragCoord.xy), last = textureSize(ps_open, 0) - 1;
  float farthest = 0.0;
  for (int i = 0; i < 4; i++) {
    ivec2 corner = ivec2(i & 1, i >> 1);
#ifdef PS_FIRST
    vec2 nearest = texelFetch(ps_open, min(u.step * at + corner, last), 0).xy;
    farthest = max(farthest, nearest.x > 0.0 ? nearest.y : PS_OPEN);
#else
    farthest = max(farthest, texelFetch(ps_open, min(at + u.step * corner, last), 0).x);
#endif
  }
  out_open = farthest;
}
