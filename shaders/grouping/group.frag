// Groups the sub-samples of each pixel: those of one instance and material whose normals and planes agree share one
// shading, and so do fibres whose tangents and depths agree. Where there would be too many groups, those of normals that agree
// less are tried, and where these are too many, too, sub-samples join the nearest one.

#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/visibility/surface_key.glsl"

#define PS_ALIKE vec2(0.99, 0.9)  // least cosine between the normals of a group: where four such are enough, and else
#define PS_APART 2.0  // pixels: farthest distance from a group's plane
#define PS_FIBRES_APART 8.0  // pixels: greatest difference in depth of a group's fibres

// Variables instead of an array, which software rasterisers would index lane by lane.
#define PS_COMPARE(G)                                                                          \
  if (G < count) {                                                                             \
    float score = dot(n, plane##G.xyz) + (surface##G == surface ? 2.0 : 0.0) -                 \
                  (abs((fibre ? d : dot(plane##G.xyz, p)) + plane##G.w) > apart ? 1.0 : 0.0);  \
    nearest = score > best ? G : nearest;                                                      \
    best = max(best, score);                                                                   \
  }
#define PS_BEGIN(G)                                                                            \
  surface##G = count == G && begins ? surface : surface##G;                                    \
  plane##G = count == G && begins ? plane : plane##G;

void main()
{
  ivec2 middle = ps_central_cell(ivec2(gl_FragCoord.xy));
  uint surface0, surface1, surface2, surface3;
  vec4 plane0, plane1, plane2, plane3;
  uvec2 codes;
  int count;
  uint first;
  bool uniform_code, open, full = true;
  for (int turn = 0; full && turn < 2; turn++) {
    surface0 = surface1 = surface2 = surface3 = 0u;
    plane0 = plane1 = plane2 = plane3 = vec4(0.0);
    codes = uvec2(0u);
    count = 0;
    first = 0u;
    uniform_code = true;
    open = full = false;
    for (int i = 0; i < PS_SUB_SAMPLES; i++) {
      ivec2 cell = middle + ps_sub_sample_cell(i);
      uint bits = texelFetch(ps_depths, cell, 0).x;
      uint code = PS_NO_GROUP;
      if (bits != 0xFFFFFFFFu) {
        uint key = texelFetch(ps_keys, cell, 0).x, surface = key >> 16u;
        float d = uintBitsToFloat(bits) + u.near;
        vec3 p = ps_view_from_pixel(ps_pixel_from_cell(vec2(cell) + 0.5), d);
        vec3 n = ps_key_normal(key);
        bool fibre = (key & PS_FIBRE_KEY) != 0u;
        vec4 plane = vec4(n, fibre ? -d : -dot(n, p));
        float apart = (fibre ? PS_FIBRES_APART : PS_APART) * ps_pixel_size(d), best = -10.0;
        int nearest = 0;
        PS_COMPARE(0)
        PS_COMPARE(1)
        PS_COMPARE(2)
        PS_COMPARE(3)
        bool another = best < 2.0 + (turn == 0 ? PS_ALIKE.x : PS_ALIKE.y), begins = another && count < PS_GROUPS;
        full = full || another != begins;
        PS_BEGIN(0)
        PS_BEGIN(1)
        PS_BEGIN(2)
        PS_BEGIN(3)
        nearest = begins ? count : nearest;
        count += begins ? 1 : 0;
        code = uint(nearest);
      }
      open = open || code == PS_NO_GROUP;
      first = i == 0 ? code : first;
      uniform_code = uniform_code && code == first;
      codes = ps_with_group(codes, i, code);
    }
  }
  codes.y |= (uint(count) << PS_COUNT_SHIFT) | (uniform_code ? PS_UNIFORM : 0u) | (open ? PS_OPEN : 0u);
  out_first = codes.x;
  out_second = codes.y;
}
