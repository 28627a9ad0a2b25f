// Whether something is open, 1 or 0: `visibility` found nothing in one of four pixels (PS_FIRST; frame.page.x pixels from
// the next four), or it is so in one of four windows, frame.page.x texels apart.

void main()
{
  ivec2 at = ivec2(gl_FragCoord.xy), last = textureSize(ps_open, 0) - 1;
  float open = 0.0;
  for (int i = 0; i < 4; i++) {
    ivec2 corner = ivec2(i & 1, i >> 1);
#ifdef PS_FIRST
    open = texelFetch(ps_open, min(frame.page.x * at + corner, last), 0).x > 0.0 ? open : 1.0;
#else
    open = max(open, texelFetch(ps_open, min(at + frame.page.x * corner, last), 0).x);
#endif
  }
  out_open = open;
}
