// A translucent splat over the picture: its optical depth along the pixel's ray (Beer's law), and the light of what of
// it lies in front of all that is opaque. PS_DEPTHS: that optical depth alone, of each channel.

#include "lib/splat/kernel.glsl"
#include "lib/translucent/place.glsl"
#ifdef PS_CAPTURED
#include "lib/captured/kind.glsl"
#ifdef PS_NODES
#include "lib/captured/node.glsl"
#endif
#endif

#ifdef PS_KERNELS
// Over the middle's of the default kernel, as ps_kernel.
float ps_profile(int row, float q)
{
  float at = q * (float(PS_PROFILE_STEPS - 1) / PS_SUPPORT);
  int low = min(int(at), PS_PROFILE_STEPS - 2);
  float a = texelFetch(ps_profiles, ivec2(low, row), 0).x, b = texelFetch(ps_profiles, ivec2(low + 1, row), 0).x;
  return mix(a, b, at - float(low)) / PS_PEAK;
}
#endif

void main()
{
  vec2 v = gl_FragCoord.xy - v_centre;
#ifdef PS_CAPTURED
  vec2 apart = vec2(v.x * v_conic.x, (v.y - v_conic.y * v.x) * v_conic.z);
  float alpha = v_source.w * exp(-0.5 * dot(apart, apart));
#endif
#ifdef PS_NODES
  if (ps_is_node(v_conic.w)) {
    alpha = ps_node_alpha(alpha, v_source.w, v_conic.w);
  }
#endif
#ifdef PS_CAPTURED_ALONE
  bool outside = !(alpha >= PS_LEAST_ALPHA);
#else
  float q = v_conic.x * v.x * v.x + 2.0 * v_conic.y * v.x * v.y + v_conic.z * v.y * v.y;
  bool outside = !(q < PS_SUPPORT);
#ifdef PS_CAPTURED
  bool captured = ps_is_captured(v_conic.w);
  outside = captured ? !(alpha >= PS_LEAST_ALPHA) : outside;
  q = captured ? 0.0 : q;
#endif
#endif
  if (outside) {
    discard;
  }
#ifdef PS_AMONG_OPAQUE
  float opaque = texelFetch(ps_depth, ivec2(gl_FragCoord.xy / u.place), 0).x;
  if (opaque == PS_NOWHERE) {
    discard;
  }
#endif
#ifdef PS_CAPTURED_ALONE
#elif defined(PS_KERNELS)
  float depth = v_source.w * ps_profile(int((v_conic.w < -0.5 ? -1.0 - v_conic.w : v_conic.w) + 0.5), q);
#else
  float depth = v_source.w * ps_kernel(q);
#endif
#ifdef PS_AMONG_OPAQUE
#ifdef PS_MATTES
  // Captured splats show through a matte, in the shadow that falls there; not those that lie before it by more than
  // their size.
  float on_matte = texelFetch(ps_depth, ivec2(gl_FragCoord.xy / u.place), 0).z;
  bool matte = on_matte >= 0.0 && ps_is_captured(v_conic.w);
  float ahead = (opaque - v_front.x - dot(v_front.zw, v)) / v_size;
  vec3 source = v_source.rgb * (matte ? mix(on_matte, 1.0, smoothstep(1.0, 3.0, ahead)) : 1.0);
#endif
  float x = (opaque - v_front.x - dot(v_front.zw, v)) * v_front.y;
  float before = ps_below(clamp(x, -6.0, 6.0));
#ifdef PS_MATTES
  before = matte ? 1.0 : before;
#endif
#else
  const float before = 1.0;
#endif
#ifndef PS_CAPTURED_ALONE
  depth *= before;
  float covered = depth < 1e-3 ? depth * (1.0 - 0.5 * depth) : 1.0 - exp(-depth);
#endif
#ifdef PS_CAPTURED
  alpha = min(alpha, PS_MOST_ALPHA);
  float hidden = before > 0.9999999 ? alpha : 1.0 - pow(1.0 - alpha, before);
#ifdef PS_CAPTURED_ALONE
  float covered = hidden;
#else
  covered = captured ? hidden : covered;
#endif
#endif
#if defined(PS_DEPTHS)
  out_color = vec4(depth * v_tint, 0.0);
#elif defined(PS_MATTES)
  out_color = vec4(source * covered, covered);
#else
  out_color = vec4(v_source.rgb * covered, covered);
#endif
#ifdef PS_HOLDOUT
  // How much of what is drawn so far the pixel's alpha is not to count; in the channel that is drawn along with alpha.
  out_cut = vec4(0.0, v_conic.w < -0.5 ? covered : 0.0, 0.0, covered);
#endif
}
