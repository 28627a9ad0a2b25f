// Groups the sub-samples of each pixel: those of one instance and material whose normals and planes agree share one
// shading.

#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/visibility/surface_key.glsl"

#define PS_ALIKE 0.9  // least cosine between the normals of a group
#define PS_APART 2.0  // pixels: farthest distance from a group's plane

void main()
{
  ivec2 middle = ps_central_cell(ivec2(gl_FragCoord.xy));
  const ivec2 cells[PS_SUB_SAMPLES] = PS_CELLS;
  uint surfaces[PS_GROUPS];
  vec4 planes[PS_GROUPS];
  uvec2 codes = uvec2(0u);
  int count = 0;
  uint first = 0u;
  bool uniform_code = true, open = false;
  for (int i = 0; i < PS_SUB_SAMPLES; i++) {
    ivec2 cell = middle + cells[i];
    uint bits = texelFetch(ps_depths, cell, 0).x;
    uint code = PS_NO_GROUP;
    if (bits != 0xFFFFFFFFu) {
      uint key = texelFetch(ps_keys, cell, 0).x, surface = key >> 16u;
      float d = uintBitsToFloat(bits) + u.near;
      vec3 p = ps_view_from_pixel(ps_pixel_from_cell(vec2(cell) + 0.5), d);
      vec3 n = ps_key_normal(key);
      float apart = PS_APART * ps_pixel_size(d), best = -10.0;
      int nearest = 0;
      for (int g = 0; g < count; g++) {
        float alike = dot(n, planes[g].xyz);
        float score = alike + (surfaces[g] == surface ? 2.0 : 0.0) -
                      (abs(dot(planes[g].xyz, p) + planes[g].w) > apart ? 1.0 : 0.0);
        nearest = score > best ? g : nearest;
        best = max(best, score);
      }
      if (best < 2.0 + PS_ALIKE && count < PS_GROUPS) {
        nearest = count;
        surfaces[count] = surface;
        planes[count] = vec4(n, -dot(n, p));
        count++;
      }
      code = uint(nearest);
    }
    open = open || code == PS_NO_GROUP;
    first = i == 0 ? code : first;
    uniform_code = uniform_code && code == first;
    codes = ps_with_group(codes, i, code);
  }
  codes.y |= (uint(count) << PS_COUNT_SHIFT) | (uniform_code ? PS_UNIFORM : 0u) | (open ? PS_OPEN : 0u);
  out_first = codes.x;
  out_second = codes.y;
}
