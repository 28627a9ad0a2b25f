// A hemisphere of directions as PS_CELLS x PS_CELLS cells of a square: the upper half of an octahedron, flattened, turned by 45
// degrees. Directions have z along the normal.

// Coordinates in cells.
vec2 ps_cell_from_direction(vec3 d)
{
  float sum = abs(d.x) + abs(d.y) + max(d.z, 0.0);
  vec2 p = d.xy / max(sum, 1e-20);
  return (vec2(p.x + p.y, p.x - p.y) * 0.5 + 0.5) * float(PS_CELLS);
}

vec3 ps_direction_from_cell(vec2 cell)
{
  vec2 q = cell * (2.0 / float(PS_CELLS)) - 1.0;
  vec2 p = vec2(q.x + q.y, q.x - q.y) * 0.5;
  return normalize(vec3(p, max(1.0 - abs(p.x) - abs(p.y), 0.0)));
}

// Solid angle that a cell would have whose surroundings were like those of a direction.
float ps_cell_solid_angle(vec3 d)
{
  float sum = abs(d.x) + abs(d.y) + max(d.z, 0.0);
  return sum * sum * sum * (2.0 / float(PS_CELLS * PS_CELLS));
}
