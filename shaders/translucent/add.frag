// One sample's picture to the sums. PS_TRAINED: its colours are display values.

#ifdef PS_TRAINED
#include "lib/captured/display.glsl"
#endif

void main()
{
  out_combined = texelFetch(ps_layer, ivec2(gl_FragCoord.xy), 0);
#ifdef PS_HOLDOUT
  out_combined.w = max(out_combined.w - texelFetch(ps_cut, ivec2(gl_FragCoord.xy), 0).y, 0.0);
#endif
#ifdef PS_TRAINED
  // The colour that shows over nothing, with alpha taken out, is what a display would show.
  float alpha = out_combined.w;
  out_combined.rgb = alpha > 0.0 ? alpha * ps_linear_from_display(out_combined.rgb / alpha) : vec3(0.0);
#endif
}
