// As many of the frame.page.x listed splats as there are pixels, frame.page.y: half the width of the kernel, the ellipse's
// area and its middle, in pixels.

#include "lib/splat/ewa.glsl"

void main()
{
  ivec2 at = ivec2(gl_FragCoord.xy);
  int side = int(sqrt(float(frame.page.y)) + 0.5);
  int index = int(float(frame.page.x) * (float(at.y * side + at.x) + 0.5) / float(frame.page.y));
  ivec2 listed = ivec2(texelFetch(ps_list, ivec2(index & 4095, index >> 12), 0).xy);
  vec3 c = texelFetch(ps_splat_shape, listed, 0).xyz;
  out_size = vec4(PS_EWA_CUTOFF_SIGMA * sqrt(max(c.x, c.z) + frame.lens.w),
                  12.566371 * sqrt(max(c.x * c.z - c.y * c.y, 0.0)),
                  texelFetch(ps_splat_place, listed, 0).xy + frame.focal.zw);
}
