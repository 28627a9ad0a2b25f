// How captured splats cover the cells of a hemisphere: in parts, of which each has 4 x 4. Included by indirect/gather.frag,
// whose PsGathered, PsSeen and arrays of cells it reads.

#define PS_BLUR 1.2  // how wide squares of captured splats are that cover parts of cells, over what their solid angle tells

float ps_layer[PS_CELLS * PS_CELLS];  // one over the distance at which the latest layer of captured splats begins
// Shares of the parts of cells that captured splats cover, a row of four parts in each, and what was covered before that layer.
vec4 ps_parts[PS_CELLS * PS_CELLS * 4];
vec4 ps_before[PS_CELLS * PS_CELLS * 4];

float ps_sum(mat4 parts)
{
  return dot(parts * vec4(1.0), vec4(1.0));
}

// Covers parts of a cell by captured splats, a rectangle of cells of which they hide a share.
void ps_cover_parts(inout PsGathered sum, ivec2 at, vec2 low, vec2 high, float share, float cell, PsSeen seen, vec4 lobe)
{
  vec2 overlap = min(high, vec2(at + 1)) - max(low, vec2(at));
  if (overlap.x <= 0.0 || overlap.y <= 0.0 || at.x >= PS_CELLS || at.y >= PS_CELLS) {
    return;
  }
  int i = at.y * PS_CELLS + at.x;
  bool behind = seen.nearness * seen.layer < ps_layer[i] || ps_layer[i] == 0.0;
  ps_layer[i] = behind ? seen.nearness : ps_layer[i];
  const vec4 steps = vec4(0.0, 0.25, 0.5, 0.75);
  vec4 across = clamp(4.0 * (min(vec4(high.x - float(at.x)), steps + 0.25) - max(vec4(low.x - float(at.x)), steps)), 0.0, 1.0);
  vec4 along = clamp(4.0 * (min(vec4(high.y - float(at.y)), steps + 0.25) - max(vec4(low.y - float(at.y)), steps)), 0.0, 1.0);
  mat4 own = mat4(ps_parts[4 * i], ps_parts[4 * i + 1], ps_parts[4 * i + 2], ps_parts[4 * i + 3]);
  mat4 before = mat4(ps_before[4 * i], ps_before[4 * i + 1], ps_before[4 * i + 2], ps_before[4 * i + 3]);
  before = behind ? own : before;
  mat4 within = outerProduct(across, along), all = mat4(vec4(1.0), vec4(1.0), vec4(1.0), vec4(1.0));
  mat4 wanted = matrixCompMult(within, all - before) * share, open_parts = all - own;
  mat4 got = mat4(min(wanted[0], open_parts[0]), min(wanted[1], open_parts[1]), min(wanted[2], open_parts[2]), min(wanted[3], open_parts[3]));
  // What finds its own parts covered closes gaps beside.
  mat4 gaps = matrixCompMult(within, open_parts - got);
  float rest = ps_sum(wanted) - ps_sum(got), room = ps_sum(gaps);
  got += gaps * min(rest / max(room, 1e-6), 1.0);
  float more = 0.0625 * ps_sum(got), so_far = 0.0625 * ps_sum(own);
  own += got;
  ps_parts[4 * i] = own[0];
  ps_parts[4 * i + 1] = own[1];
  ps_parts[4 * i + 2] = own[2];
  ps_parts[4 * i + 3] = own[3];
  ps_before[4 * i] = before[0];
  ps_before[4 * i + 1] = before[1];
  ps_before[4 * i + 2] = before[2];
  ps_before[4 * i + 3] = before[3];
  // What else covers the cell covers its parts alike.
  float covered = ps_covered[i], covers = min(more / max(1.0 - so_far, 1e-6), 1.0) * (1.0 - covered);
  covered += covers;
  float weight = covers * cell * PS_COSINE(seen.direction);
  sum.nearness += weight * seen.nearness;
  ps_covered[i] = covered;
  ps_weight[i] += weight;
#ifndef PS_OCCLUSION
  ps_light[i] += seen.radiance * weight;
#endif
#ifdef PS_MEDIA
  ps_distance[i] += weight / max(seen.nearness, 1e-30);
#endif
  uint full = covered >= PS_FULL ? 1u << uint((at.y & 3) * 8 + at.x) : 0u;
  ps_full |= at.y < 4 ? uvec2(full, 0u) : uvec2(0u, full);
  ps_add_glossy(sum, i, seen.radiance, covers * cell, seen.direction, lobe);
}

// A piece of captured splats, smaller than a cell, hides the rectangle around its own picture, of a part's size at least.
void ps_deposit_parts(inout PsGathered sum, PsSeen seen, vec4 lobe)
{
  float cell = ps_cell_solid_angle(seen.direction), angle = (seen.front + seen.back) / cell;
  vec2 centre = ps_cell_from_direction(seen.direction);
  // Half-axes of the picture of a square that is tilted.
  float side = sqrt((seen.front + seen.back) / seen.upright) * 0.5;
  vec3 across = cross(seen.normal, seen.direction);
  across *= side * inversesqrt(max(dot(across, across), 1e-12));
  vec3 first_end = seen.direction + across, second_end = seen.direction + seen.upright * cross(seen.direction, across);
  vec2 first_axis = ps_cell_from_direction(normalize(vec3(first_end.xy, max(first_end.z, 0.0)))) - centre;
  vec2 second_axis = ps_cell_from_direction(normalize(vec3(second_end.xy, max(second_end.z, 0.0)))) - centre;
  vec2 reach = clamp(PS_BLUR * sqrt(first_axis * first_axis + second_axis * second_axis), 0.125, 0.5);
  vec2 low = clamp(centre - reach, vec2(0.0), vec2(PS_CELLS)), high = clamp(centre + reach, vec2(0.0), vec2(PS_CELLS));
  vec2 sides = max(high - low, 1e-6);
  float share = angle / (sides.x * sides.y);
  ivec2 first = ivec2(low);
  ps_cover_parts(sum, first, low, high, share, cell, seen, lobe);
  ps_cover_parts(sum, first + ivec2(1, 0), low, high, share, cell, seen, lobe);
  ps_cover_parts(sum, first + ivec2(0, 1), low, high, share, cell, seen, lobe);
  ps_cover_parts(sum, first + ivec2(1, 1), low, high, share, cell, seen, lobe);
}
