// One sample's picture to the sums.
void main()
{
  out_combined = texelFetch(ps_layer, ivec2(gl_FragCoord.xy), 0);
#ifdef PS_HOLDOUT
  out_combined.w = max(out_combined.w - texelFetch(ps_cut, ivec2(gl_FragCoord.xy), 0).y, 0.0);
#endif
}
