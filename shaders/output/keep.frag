// A copy of the sums so far.
void main()
{
  out_color = texelFetch(ps_combined, ivec2(gl_FragCoord.xy), 0);
}
