// u.probes of the u.count listed splats, as many as there are pixels: half the width of the kernel, the ellipse's
// area and its middle, in pixels.

#include "lib/splat/ewa.glsl"

void main()
{
  ivec2 at = ivec2(gl_FragCoord.xy);
  int side = int(sqrt(float(u.probes)) + 0.5);
  int index = int(float(u.count) * (float(at.y * side + at.x) + 0.5) / float(u.probes));
  ivec2 listed = ivec2(texelFetch(ps_list, ivec2(index & 4095, index >> 12), 0).xy);
  vec3 c = texelFetch(ps_splat_shape, listed, 0).xyz;
  out_size = vec4(PS_EWA_CUTOFF_SIGMA * sqrt(max(c.x, c.z) + u.low_pass),
                  12.566371 * sqrt(max(c.x * c.z - c.y * c.y, 0.0)),
                  texelFetch(ps_splat_centre, listed, 0).xy + u.principal_point);
}
