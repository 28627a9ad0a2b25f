// One sample's picture to the sums.
void main()
{
  out_combined = texelFetch(ps_layer, ivec2(gl_FragCoord.xy), 0);
}
