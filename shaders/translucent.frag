// A translucent splat over the picture: its optical depth along the pixel's ray (Beer's law), and the light of what of
// it lies in front of all that is opaque.

#include "lib/kernel.glsl"

// Share of a Gaussian below x standard deviations, to 3e-4.
float ps_below(float x)
{
  return 1.0 / (1.0 + exp(-1.5957691 * (x + 0.044715 * x * x * x)));
}

void main()
{
  vec2 v = gl_FragCoord.xy - v_centre;
  float q = v_conic.x * v.x * v.x + 2.0 * v_conic.y * v.x * v.y + v_conic.z * v.y * v.y;
  if (!(q < PS_SUPPORT)) {
    discard;
  }
  float depth = v_source.w * ps_kernel(q);
#ifdef PS_AMONG_OPAQUE
  float opaque = texelFetch(ps_depth, ivec2(gl_FragCoord.xy / frame.lens.w), 0).x;
  float x = (opaque - v_front.x - dot(v_front.zw, v)) * v_front.y;
  depth *= ps_below(clamp(x, -6.0, 6.0));
#endif
  float covered = depth < 1e-3 ? depth * (1.0 - 0.5 * depth) : 1.0 - exp(-depth);
  out_color = vec4(v_source.rgb * covered, covered);
}
