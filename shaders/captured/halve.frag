// Narrows the places between which half of the light is hidden (captured/hides.frag) to a fifth of their distance.

#include "lib/captured/span.glsl"

#define PS_HALF 0.69314718  // optical depth

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec2 span = texelFetch(ps_span, pixel, 0).xy;
  vec4 places = ps_places_between(span), hidden = texelFetch(ps_hidden, pixel, 0);
  vec2 found = span;
  for (int i = 0; i < 4; i++) {
    bool half_hidden = hidden[i] >= PS_HALF;
    found.x = half_hidden ? max(found.x, places[i]) : found.x;
    found.y = half_hidden ? found.y : min(found.y, places[i]);
  }
  out_span = vec4(found, 0.0, 0.0);
}
