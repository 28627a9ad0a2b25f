// The share of light that panes let through, brought to its place among all maps.

void main()
{
  out_depth = floatBitsToUint(texelFetch(ps_shares, ivec2(gl_FragCoord.xy) - u.corner, 0).x);
}
