// Opaque splats into the visibility buffer, one invocation each: the least depth of each sub-sample, then (PS_IDENTIFY) the
// lowest number among the splats that have it, and the key of its surface. PS_LIST: instead, lists those that cover more cells than PS_MOST_CELLS, which the
// rasteriser draws; without it these are left out.

#include "lib/data/index.glsl"
#include "lib/visibility/splat.glsl"
#include "lib/visibility/surface_key.glsl"

#ifndef PS_LIST
PsSplatHit ps_hit(PsUnitSplat splat, ivec2 cell)
{
  PsSplatHit hit = ps_meet_splat(splat, vec2(cell) + 0.5 - splat.centre);
#if defined(PS_NODES) || defined(PS_PARTLY)
  hit.there = hit.there && ps_is_covered(splat.covered, hit.share, cell);
#endif
  return hit;
}

uint ps_depth_key(PsSplatHit hit)
{
  return floatBitsToUint(max(hit.depth - u.near, 0.0));
}

#ifdef PS_IDENTIFY
void ps_identify(PsUnitSplat splat, PsSplatHit hit, ivec2 cell, uint number, int instance, int material, vec3 toward)
{
  // Of several at one depth any may write its key: they then lie upon each other.
  uint before = imageAtomicMin(ids, cell, number);
  if (before > number) {
    uint surface = ps_surface_key(instance, material, ps_splat_normal(splat, hit, toward));
    imageStore(keys, cell, uvec4(surface));
  }
}
#endif
#endif

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
#ifdef PS_ROUND
  for (int y = low.y; y <= high.y; y++) {
    vec2 ends = ps_row_ends(splat, float(y) + 0.5 - splat.centre.y) + splat.centre.x - 0.5;
    int first = splat.conic.x > 0.0 ? max(low.x, int(ceil(ends.x))) : low.x;
    int last = splat.conic.x > 0.0 ? min(high.x, int(floor(ends.y))) : high.x;
    for (int x = first; x <= last; x++) {
      PsSplatHit hit = ps_hit(splat, ivec2(x, y));
      uint key = ps_depth_key(hit);
#ifdef PS_IDENTIFY
      if (hit.there && texelFetch(ps_depths, ivec2(x, y), 0).x == key) {
        ps_identify(splat, hit, ivec2(x, y), uint(u.first_index + index), element.z, material, toward);
      }
#else
      if (hit.there) {
        imageAtomicMin(depths, ivec2(x, y), key);
      }
#endif
    }
  }
#else
  // One loop over all cells, for a software renderer goes on as long as the longest of those that it runs together.
  int count = span.x * span.y;
  ivec2 cell = low;
#ifdef PS_IDENTIFY
  for (int start = 0; start < count; start += 32) {
    uint shown = 0u;
    ivec2 begin = cell;
    for (int i = 0; i < min(count - start, 32); i++) {
      PsSplatHit hit = ps_hit(splat, cell);
      bool same = hit.there && texelFetch(ps_depths, cell, 0).x == ps_depth_key(hit);
      shown |= same ? 1u << uint(i) : 0u;
      cell = cell.x < high.x ? ivec2(cell.x + 1, cell.y) : ivec2(low.x, cell.y + 1);
    }
    while (shown != 0u) {
      int along = begin.x - low.x + findLSB(shown);
      ivec2 there = ivec2(low.x + along % span.x, begin.y + along / span.x);
      shown &= shown - 1u;
      ps_identify(splat, ps_hit(splat, there), there, uint(u.first_index + index), element.z, material, toward);
    }
  }
#else
  for (int i = 0; i < count; i++) {
    PsSplatHit hit = ps_hit(splat, cell);
    if (hit.there) {
      imageAtomicMin(depths, cell, ps_depth_key(hit));
    }
    cell = cell.x < high.x ? ivec2(cell.x + 1, cell.y) : ivec2(low.x, cell.y + 1);
  }
#endif
#endif
#endif
}
