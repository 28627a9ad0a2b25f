// Each splat to the one pixel that holds its centre (Marroquim et al. 2008, section 3), or where it is disconnected to all
// pixels whose centres it covers (PS_DISCONNECTED): the least depth of each pixel, then (PS_IDENTIFY) the lowest index among the
// splats that have it. PS_MARK: instead, which blocks have splats in the tiles that `ps_tiles` names.

#include "lib/data/index.glsl"
#include "lib/geometry/footprint.glsl"

#ifndef PS_MARK
void ps_put(ivec2 texel, uint key, int index, uint beside)
{
#ifdef PS_IDENTIFY
  if ((texelFetch(ps_depth, texel, 0).x & ~PS_OFF_CENTRE) == key) {
    imageAtomicMin(ids, texel, uint(u.first_index + index) | beside);
  }
#else
  imageAtomicMin(depth, texel, key | beside);
#endif
}
#endif

void main()
{
  int index = ps_index();
  ivec3 element = ps_element(index);
  if (element.x < 0) {
    return;
  }
  vec4 head = texelFetch(ps_position, element.xy, 0);
  vec3 view = ps_view_from_point(element.z, head.xyz);
  vec3 pixel = ps_pixel_from_view(view);
  if (!ps_in_frame(pixel)) {
    return;
  }
#ifdef PS_CULL
  int material = int(texelFetch(ps_extent, element.xy, 0).w);
  if (texelFetch(ps_materials, ivec2(2, material), 0).x > 0.5 && head.w >= 0.0) {
    vec3 normal = ps_view_normal(ps_linear(element.z), ps_unpack_normal(head.w));
    vec3 toward = ps_is_perspective() ? -view : vec3(0.0, 0.0, 1.0);
    if (dot(normal, toward) < 0.0) {
      return;
    }
  }
#endif
  ivec2 texel = ivec2(pixel.xy);
#ifdef PS_MARK
  if (texelFetch(ps_tiles, texel / PS_TILE, 0).x != 0.0) {
    imageAtomicMin(marks, ps_texel(index >> u.block_shift), 0u);
  }
#else
  uint key = floatBitsToUint(pixel.z - u.near);
  // Splats that hold the pixel's centre come before those that only lie in the pixel: on a dense surface the nearest
  // one is always at the same side of the pixel, and would miss its centre.
  vec4 extent = texelFetch(ps_extent, element.xy, 0);
  vec3 covariance = ps_footprint(element.z, view, head.w, extent);
#ifdef PS_DISCONNECTED
  if (ps_alone(covariance, extent)) {
    vec2 reach = 2.0 * sqrt(covariance.xz);
    ivec2 low = max(ivec2(ceil(pixel.xy - reach - 0.5)), ivec2(0));
    ivec2 high = min(ivec2(floor(pixel.xy + reach - 0.5)), u.size - 1);
    for (int y = low.y; y <= high.y; y++) {
      for (int x = low.x; x <= high.x; x++) {
        if (ps_off_centre(covariance, pixel.xy - (vec2(x, y) + 0.5)) == 0u) {
          ps_put(ivec2(x, y), key, index, 0u);
        }
      }
    }
    return;
  }
#endif
  ps_put(texel, key, index, ps_off_centre(covariance, pixel.xy - (vec2(texel) + 0.5)));
#endif
}
