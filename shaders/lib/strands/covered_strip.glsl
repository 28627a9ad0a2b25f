// Segments of strands in the cells of sub-samples. Those that are narrower than a cell, measured along the axis of the lattice
// across which they run, are as wide as one: one cell of each column, or row, that they cross. They cover a share of these.
// PS_THIN: raster lines. Else pairs of triangles, of which those that are thin are parallelograms.

#include "lib/strands/segment.glsl"
#include "lib/strands/strip.glsl"
#include "lib/visibility/lattice.glsl"

struct PsCovered {
  vec4 clip;  // in the target of cells
  vec3 position;  // in view space
  // Along that axis, in one unit: the strand's extent, and that of what is drawn. Ribbons that turn over change its sign.
  vec2 extent;
  bool rows;  // the axis is that of rows
  vec3 line;  // PS_THIN: a point's place along the other axis and along this one, in cells, and the slope of the line there
};

// Of a segment's picture: its direction in cells, no longer than 1.
vec2 ps_cell_direction(vec2 chord)
{
  float len = length(chord);
  vec2 along = len > 1e-3 ? chord / len : vec2(1.0, 0.0);
  return vec2(u.lattice.x * along.x - u.lattice.y * along.y, u.lattice.y * along.x + u.lattice.x * along.y) /
         length(u.lattice.xy);
}

#ifdef PS_THIN

PsCovered ps_covered(PsSegment segment, int end)
{
  vec3 p[2] = vec3[2](ps_view_from_point(segment.instance, texelFetch(ps_point, segment.from, 0).xyz),
                      ps_view_from_point(segment.instance, texelFetch(ps_point, segment.to, 0).xyz));
  vec2 from = ps_pixel_from_view(p[0]).xy, direction = ps_cell_direction(ps_pixel_from_view(p[1]).xy - from);
  PsCovered found;
  found.position = p[end];
  found.clip = ps_cell_clip(ps_clip_from_view(p[end]));
  found.extent = found.clip.w * vec2(end == 0 ? segment.rest.x : segment.rest.y, 1.0);
  found.rows = abs(direction.y) > abs(direction.x);
  vec2 cell = ps_cell_from_pixel(from);
  found.line = found.rows ? vec3(cell.yx, direction.x / direction.y) : vec3(cell, direction.y / direction.x);
  return found;
}

#else

#define PS_MOST_SCALED 2.0  // how many times wider or narrower than a strand a strip may be to make up for its bends

struct PsStrip {
  vec3 position[2], side[2];  // in view space; from the middle to an edge
  bool cut;  // by the near plane
};

// False: the segment lies before the near plane.
bool ps_strip(PsSegment segment, out PsStrip strip)
{
  mat3 linear = ps_linear(segment.instance);
  ivec2 texel[2] = ivec2[2](segment.from, segment.to);
  for (int i = 0; i < 2; i++) {
    vec4 point = texelFetch(ps_point, texel[i], 0);
    strip.position[i] = ps_view_from_point(segment.instance, point.xyz);
#ifdef PS_RIBBON
    strip.side[i] = linear * texelFetch(ps_side, texel[i], 0).xyz * point.w;
#else
    vec3 toward = ps_is_perspective() ? strip.position[i] : vec3(0.0, 0.0, -1.0);
    vec3 side = cross(linear * texelFetch(ps_tangent, texel[i], 0).xyz, toward);
    strip.side[i] = side * (ps_instance_row(segment.instance, 3).y * point.w / max(length(side), 1e-30));
#endif
  }
  // What lies before the near plane has no picture that it could be as wide as.
  float near = max(u.near, 1e-12), first = -strip.position[0].z - near, second = -strip.position[1].z - near;
  strip.cut = ps_is_perspective() && min(first, second) < 0.0;
  if (strip.cut) {
    int end = first < second ? 0 : 1;
    float at = first / (first - second);
    vec3 position = mix(strip.position[0], strip.position[1], at), side = mix(strip.side[0], strip.side[1], at);
    strip.position[end] = position;
    strip.side[end] = side;
  }
  return !strip.cut || max(first, second) > 0.0;
}

// In cells, across the strip's picture: from one edge to the other; its sign tells the side of ribbons that is seen.
float ps_edge_to_edge(vec3 position, vec3 side, vec2 direction)
{
  float scale = ps_is_perspective() ? -1.0 / position.z : 1.0;
  vec2 moved = ps_is_perspective() ? side.xy + position.xy * (scale * side.z) : side.xy;
  vec2 d = u.focal * (scale * moved);
  vec2 cells = vec2(u.lattice.x * d.x - u.lattice.y * d.y, u.lattice.y * d.x + u.lattice.x * d.y);
  return 2.0 * (direction.x * cells.y - direction.y * cells.x);
}

// In cells: the distance between the outlines of a tube, where planes through the eye touch it.
float ps_tube_width(vec3 position, float radius, vec2 chord)
{
  float len = length(chord);
  vec2 along = len > 1e-3 ? chord / len : vec2(1.0, 0.0), normal = vec2(-along.y, along.x);
  float depth = ps_is_perspective() ? -position.z : 1.0;
  float away = ps_is_perspective() ? dot(normal, u.focal * position.xy) / depth : 0.0;
  vec2 across = u.focal * normal;
  return 2.0 * radius / depth * sqrt(dot(across, across) + away * away) * length(u.lattice.xy);
}

// One of the six corners of two triangles.
PsCovered ps_covered(PsSegment segment, PsStrip strip, int corner)
{
  vec2 chord = ps_pixel_from_view(strip.position[1]).xy - ps_pixel_from_view(strip.position[0]).xy;
  vec2 direction = ps_cell_direction(chord);
  float slope = max(abs(direction.x), abs(direction.y));
  // In cells, across the chord: what the strip has from edge to edge, and what it should have.
  float own[2], wanted[2];
  for (int i = 0; i < 2; i++) {
    own[i] = ps_edge_to_edge(strip.position[i], strip.side[i], direction);
#ifdef PS_RIBBON
    wanted[i] = own[i];
#else
    wanted[i] = ps_tube_width(strip.position[i], length(strip.side[i]), chord);
#endif
    float share = i == 0 ? segment.rest.x : segment.rest.y;
    wanted[i] = share >= 0.0 && !strip.cut ? (wanted[i] < 0.0 ? -share : share) * slope : wanted[i];
  }
  PsCovered found;
  found.rows = abs(direction.y) > abs(direction.x);
  if (max(abs(wanted[0]), abs(wanted[1])) < slope) {
    int end = corner == 1 || corner == 2 || corner == 4 ? 1 : 0;
    float right = corner == 2 || corner == 4 || corner == 5 ? 1.0 : -1.0;
    found.position = strip.position[end];
    found.clip = ps_cell_clip(ps_clip_from_view(found.position));
    found.clip.xy += (found.rows ? vec2(right, 0.0) : vec2(0.0, right)) / u.cells * found.clip.w;
    found.extent = found.clip.w * vec2(wanted[end] / slope, 1.0);
    return found;
  }
  for (int i = 0; i < 2; i++) {
    float scale = abs(wanted[i]) / max(abs(own[i]), 1e-12);
    strip.side[i] *= clamp(scale, 1.0 / PS_MOST_SCALED, PS_MOST_SCALED);
  }
  float along;
  found.position = ps_strip_corner(corner, strip.position, strip.side, along);
  found.clip = ps_cell_clip(ps_clip_from_view(found.position));
  found.extent = vec2(1.0);
  return found;
}

#endif
