// Opaque splats into the visibility buffer, one invocation each: the least depth of each sub-sample, then (PS_IDENTIFY) the
// lowest number among the splats that have it, and the key of its surface. PS_LIST: instead, lists those that cover more cells than PS_MOST_CELLS, which the
// rasteriser draws; without it these are left out.

#include "lib/data/index.glsl"
#include "lib/visibility/splat.glsl"
#include "lib/visibility/surface_key.glsl"

void main()
{
#ifdef PS_DIRECT
  int index = u.first_splat + ps_index();
#else
  int index = ps_index();
#endif
  ivec3 element = ps_element(index);
  if (element.x < 0) {
    return;
  }
  PsUnitSplat splat;
  if (!ps_unit_splat(element, splat)) {
    return;
  }
#ifdef PS_CULL
  if (ps_is_culled(element)) {
    return;
  }
#endif
  vec4 box = clamp(splat.box, vec4(0.0), u.cells.xyxy);
  ivec2 low = ivec2(ceil(box.xy - 0.51)), high = min(ivec2(floor(box.zw - 0.49)), ivec2(u.cells) - 1);
  ivec2 span = high - low + 1;
  if (span.x <= 0 || span.y <= 0) {
    return;
  }
  bool wide = span.x * span.y > PS_MOST_CELLS;
#ifdef PS_LIST
  if (wide) {
    // The length counts from -1, which EMPTY is.
    uint entry = imageAtomicAdd(list_length, ivec2(0), 1u) + 1u;
    if (entry < uint(u.list_size)) {
      imageAtomicMin(list, ps_texel(int(entry)), uint(index));
    }
  }
#else
  if (wide) {
    return;
  }
#ifdef PS_IDENTIFY
  int material = int(ps_splat_extent(element).w);
  vec3 toward = ps_is_perspective() ? ps_view_from_point(element.z, texelFetch(ps_position, element.xy, 0).xyz)
                                    : vec3(0.0, 0.0, -1.0);
#endif
  for (int y = low.y; y <= high.y; y++) {
    int first = low.x, last = high.x;
#ifdef PS_ROUND
    vec2 ends = ps_row_ends(splat, float(y) + 0.5 - splat.centre.y) + splat.centre.x - 0.5;
    first = splat.conic.x > 0.0 ? max(first, int(ceil(ends.x))) : first;
    last = splat.conic.x > 0.0 ? min(last, int(floor(ends.y))) : last;
#endif
    for (int x = first; x <= last; x++) {
      PsSplatHit hit = ps_meet_splat(splat, vec2(x, y) + 0.5 - splat.centre);
#if defined(PS_NODES) || defined(PS_PARTLY)
      hit.there = hit.there && ps_is_covered(splat.covered, hit.share, ivec2(x, y));
#endif
      if (hit.there) {
        uint key = floatBitsToUint(max(hit.depth - u.near, 0.0));
#ifdef PS_IDENTIFY
        if (texelFetch(ps_depths, ivec2(x, y), 0).x == key) {
          // Of several at one depth any may write its key: they then lie upon each other.
          uint before = imageAtomicMin(ids, ivec2(x, y), uint(u.first_index + index));
          if (before > uint(u.first_index + index)) {
            uint surface = ps_surface_key(element.z, material, ps_splat_normal(splat, hit, toward));
            imageStore(keys, ivec2(x, y), uvec4(surface));
          }
        }
#else
        imageAtomicMin(depths, ivec2(x, y), key);
#endif
      }
    }
  }
#endif
}
