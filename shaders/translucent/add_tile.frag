// What translucent splats change in a tile, to the sums. u.corner: where in the picture the tile begins.
void main()
{
  out_combined = texelFetch(ps_difference, ivec2(gl_FragCoord.xy) - u.corner, 0);
}
