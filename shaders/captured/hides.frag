// What captured splats hide of the light behind them, as optical depths, of those in front of four places in their order: those whose
// index is not less than the place is. Texels of ps_span: two places between which half of the light is hidden.

#include "lib/captured/kind.glsl"
#ifdef PS_NODES
#include "lib/captured/node.glsl"
#endif
#include "lib/captured/span.glsl"

void main()
{
  vec2 v = gl_FragCoord.xy - v_centre;
  vec2 apart = vec2(v.x * v_conic.x, (v.y - v_conic.y * v.x) * v_conic.z);
  float alpha = v_source.w * exp(-0.5 * dot(apart, apart));
#ifdef PS_NODES
  if (ps_is_node(v_conic.w)) {
    alpha = ps_node_alpha(alpha, v_source.w, v_conic.w);
  }
#endif
  if (!(alpha >= PS_LEAST_ALPHA)) {
    discard;
  }
  vec4 places = ps_places_between(texelFetch(ps_span, ivec2(gl_FragCoord.xy), 0).xy);
  out_hidden = -log(1.0 - min(alpha, PS_MOST_ALPHA)) * vec4(greaterThanEqual(vec4(v_index), places));
}
