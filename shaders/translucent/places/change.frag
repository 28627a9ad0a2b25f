// What translucent splats change at the places where they are looked at: what they send (ps_layer, blended over nothing) less
// what they hide of what is opaque (ps_opaque). Splats are blurred there; the mean of exp(-depth) over a Gaussian within
// which depths change evenly is exp(deviation^2 slope^2 / 2) times that of the mean depth. Cells whose ps_place is nowhere hold
// nothing. PS_DEVIATION: of the blur, in pixels. u.spacing: pixels from a place to the next.

#include "lib/translucent/place.glsl"

// Optical depth of a place beside another, whose own is `depth`: that one's if there is none.
float ps_depth_beside(ivec2 cell, float depth)
{
  cell = clamp(cell, ivec2(0), textureSize(ps_layer, 0) - 1);
  float left = max(1.0 - texelFetch(ps_layer, cell, 0).w, 1e-6);
  return texelFetch(ps_place, cell, 0).x == PS_NOWHERE ? depth : -log(left);
}

void main()
{
  ivec2 cell = ivec2(gl_FragCoord.xy);
  vec4 sent = texelFetch(ps_layer, cell, 0);
  out_change = vec4(0.0);
  if (sent.w > 0.0) {
    float left = max(1.0 - sent.w, 1e-6), depth = -log(left);
    float x = ps_depth_beside(cell + ivec2(1, 0), depth) - ps_depth_beside(cell - ivec2(1, 0), depth);
    float y = ps_depth_beside(cell + ivec2(0, 1), depth) - ps_depth_beside(cell - ivec2(0, 1), depth);
    float slope = PS_DEVIATION * length(vec2(x, y)) / (2.0 * u.spacing);
    // exp(x) - 1 with all its digits: what glows may hide next to nothing.
    float half_square = min(0.5 * slope * slope, 1.0);
    float more = half_square < 0.1 ? half_square * (1.0 + half_square * (0.5 + half_square / 6.0)) : exp(half_square) - 1.0;
    float hidden = max(sent.w - left * more, 0.0);
    out_change = sent * (hidden / sent.w) - hidden * texelFetch(ps_opaque, cell, 0);
  }
}
