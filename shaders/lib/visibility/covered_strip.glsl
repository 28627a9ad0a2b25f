// Strips in the cells of sub-samples that cover as much as strands are wide. Strips narrower than a cell are as wide as one,
// measured along the axis of the lattice across which they run: one cell of each column, or row, that they cross. They cover
// a share of these cells.

#include "lib/visibility/segment.glsl"
#include "lib/visibility/strip.glsl"
#include "lib/visibility/lattice.glsl"

#define PS_MOST_SCALED 2.0  // how many times wider or narrower than a strand a strip may be to make up for its bends

struct PsStripEnds {
  vec3 position[2], side[2];  // in view space; from the middle to an edge
  vec2 along;  // 0 at the segment's first point, 1 at its second
  bool cut;  // by the near plane
};

struct PsStripCorner {
  vec4 clip;  // in the target of cells
  vec3 position;  // in view space
  vec2 extent;  // across the strip, in one unit: the strand's; that of the strip. Ribbons that turn over change its sign
  bool rows;  // a thin strip has a cell in each row, not in each column
};

vec2 ps_cells_from_pixels(vec2 d)
{
  return vec2(u.lattice.x * d.x - u.lattice.y * d.y, u.lattice.y * d.x + u.lattice.x * d.y);
}

// How far a point's picture moves with the point, in cells.
vec2 ps_cells_along(vec3 position, vec3 step)
{
  float scale = ps_is_perspective() ? -1.0 / position.z : 1.0;
  vec2 moved = ps_is_perspective() ? step.xy + position.xy * (scale * step.z) : step.xy;
  return ps_cells_from_pixels(u.focal * (scale * moved));
}

// False: the segment lies before the near plane.
bool ps_strip_ends(PsSegment segment, out PsStripEnds ends)
{
  mat3 linear = ps_linear(segment.instance);
  ivec2 texel[2] = ivec2[2](segment.from, segment.to);
  for (int i = 0; i < 2; i++) {
    vec4 point = texelFetch(ps_point, texel[i], 0);
    ends.position[i] = ps_view_from_point(segment.instance, point.xyz);
#ifdef PS_RIBBON
    ends.side[i] = linear * texelFetch(ps_side, texel[i], 0).xyz * point.w;
#else
    vec3 toward = ps_is_perspective() ? ends.position[i] : vec3(0.0, 0.0, -1.0);
    vec3 side = cross(linear * texelFetch(ps_tangent, texel[i], 0).xyz, toward);
    ends.side[i] = side * (ps_instance_row(segment.instance, 3).y * point.w / max(length(side), 1e-30));
#endif
  }
  ends.along = vec2(0.0, 1.0);
  // Before the near plane nothing has a picture to be as wide as.
  float near = max(u.near, 1e-12), first = -ends.position[0].z - near, second = -ends.position[1].z - near;
  ends.cut = ps_is_perspective() && min(first, second) < 0.0;
  if (ends.cut) {
    int end = first < second ? 0 : 1;
    float at = first / (first - second);
    vec3 position = mix(ends.position[0], ends.position[1], at), side = mix(ends.side[0], ends.side[1], at);
    ends.position[end] = position;
    ends.side[end] = side;
    ends.along[end] = at;
  }
  return !ends.cut || max(first, second) > 0.0;
}

// One of the six corners of two triangles.
PsStripCorner ps_covered_strip(PsSegment segment, PsStripEnds ends, int corner)
{
  vec2 from = ps_pixel_from_view(ends.position[0]).xy, to = ps_pixel_from_view(ends.position[1]).xy;
  vec2 chord = ps_cells_from_pixels(to - from);
  float len = length(chord);
  vec2 direction = len > 1e-6 ? chord / len : vec2(1.0, 0.0);
  vec2 pixels = abs(to - from);
  float line = max(pixels.x, pixels.y) / max(length(pixels), 1e-6), cells = length(u.lattice.xy);
  // In cells, across the chord: the strand's width, and what the strip from edge to edge would have.
  float wanted[2], own[2];
  for (int i = 0; i < 2; i++) {
    vec2 side = ps_cells_along(ends.position[i], ends.side[i]);
    own[i] = 2.0 * (direction.x * side.y - direction.y * side.x);
    float width = own[i];
#ifndef PS_RIBBON
    vec3 toward = ps_is_perspective() ? ends.position[i] : vec3(0.0, 0.0, -1.0);
    vec3 across = cross(ends.position[1] - ends.position[0], toward);
    side = ps_cells_along(ends.position[i], across * (length(ends.side[i]) / max(length(across), 1e-30)));
    wanted[i] = 2.0 * abs(direction.x * side.y - direction.y * side.x);
    width = 2.0 * cells * length(ends.side[i]) * sqrt(abs(u.focal.x * u.focal.y)) /
            (ps_is_perspective() ? -ends.position[i].z : 1.0);
#else
    wanted[i] = own[i];
#endif
    // A segment that stands for several has their area.
    float share = i == 0 ? segment.rest.x : segment.rest.y;
    if (share >= 0.0 && !ends.cut) {
      float factor = share * line * cells / max(abs(width), 1e-12);
      wanted[i] *= min(factor, max(PS_MOST_SCALED, 1.0 / max(abs(wanted[i]), 1e-12)));
    }
  }
  bool rows = abs(direction.y) > abs(direction.x);
  float slope = max(abs(direction.x), abs(direction.y));
  bool thin = max(abs(wanted[0]), abs(wanted[1])) < slope;
  PsStripCorner found;
  found.rows = rows;
  if (thin) {
    int end = corner == 1 || corner == 2 || corner == 4 ? 1 : 0;
    float right = corner == 2 || corner == 4 || corner == 5 ? 1.0 : -1.0;
    found.position = ends.position[end];
    found.clip = ps_cell_clip(ps_clip_from_view(found.position));
    found.clip.xy += (rows ? vec2(right, 0.0) : vec2(0.0, right)) / u.cells * found.clip.w;
    found.extent = found.clip.w * vec2(wanted[end] / slope, 1.0);
  } else {
    for (int i = 0; i < 2; i++) {
      float scale = abs(wanted[i]) / max(abs(own[i]), 1e-12);
      ends.side[i] *= clamp(scale, 1.0 / PS_MOST_SCALED, PS_MOST_SCALED);
    }
    float along;
    found.position = ps_strip_corner(corner, ends.position, ends.side, along);
    found.clip = ps_cell_clip(ps_clip_from_view(found.position));
    found.extent = vec2(1.0);
  }
  return found;
}
