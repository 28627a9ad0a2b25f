// The depths of one view from a light, brought to their place among all maps.

void main()
{
  out_depth = texelFetch(ps_depths, ivec2(gl_FragCoord.xy) - u.corner, 0).x;
}
