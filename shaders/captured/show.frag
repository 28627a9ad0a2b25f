// The light that captured splats send to the eye, premultiplied, and what they hide, in each pixel.

void main()
{
  out_color = texelFetch(ps_picture, ivec2(gl_FragCoord.xy), 0);
}
