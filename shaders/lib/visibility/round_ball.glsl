// Where rays through sub-samples meet a ball that is round in view space. Rays are told apart by their cells, relative to that of
// the ball's centre, so that nothing is lost by rounding far from the eye.
//
// With m the slopes of the ray through the centre (0 in a parallel view), q the difference of slopes to another one (or of positions
// in a parallel view), d the centre's depth and r the radius, the ray meets the ball at the depth
//
//     d - (d h + r sqrt(-F)) / g,   g = |m + q|^2 + 1,   h = (m + q) . q,   F = (d / r)^2 (|q|^2 (|m|^2 + 1) - (m . q)^2) - g
//
// and where F > 0 not at all; in a parallel view with g = 1, h = 0 and 1 / r for d / r.

struct PsUnitSplat {
  vec2 centre;  // in cells
  float depth;  // of the centre
  float radius;
  float lift;  // the centre's depth, or 1 in a parallel view
  vec2 slopes;  // of the ray through the centre; 0 in a parallel view
  vec2 step_x, step_y;  // of a cell, in slopes or positions
  float lengthened;  // |slopes|^2 + 1
  vec3 conic;  // F over cells: factors of x^2, x y, y^2
  vec2 tilt;  // of x, y; the constant is -lengthened
  vec4 box;  // in cells, from the centre: low and high corner
};

struct PsSplatHit {
  bool there;
  float depth;
  vec2 aside;  // q
  float back;  // the depth without that of the centre
};

// False: the ball lies outside of the picture, or is nothing.
bool ps_unit_splat(ivec3 element, out PsUnitSplat splat)
{
  vec3 p = ps_view_from_point(element.z, ps_splat_head(element).xyz);
  splat.depth = -p.z;
  splat.radius = ps_splat_extent(element).x * length(ps_linear(element.z)[0]);
  if (!(splat.radius > 1e-37) || splat.depth + splat.radius < u.near || splat.depth - splat.radius > u.far) {
    return false;
  }
  // From cells to slopes, or positions in a parallel view: the lattice's matrix is a rotation times a scale.
  float square = dot(u.lattice.xy, u.lattice.xy), perspective = ps_is_perspective() ? 1.0 : 0.0;
  splat.step_x = vec2(u.lattice.x, -u.lattice.y) / (square * u.focal);
  splat.step_y = u.lattice.yx / (square * u.focal);
  splat.lift = ps_is_perspective() ? splat.depth : 1.0;
  splat.slopes = perspective * p.xy / splat.lift;
  splat.lengthened = 1.0 + dot(splat.slopes, splat.slopes);
  vec2 m = vec2(dot(splat.slopes, splat.step_x), dot(splat.slopes, splat.step_y));
  vec3 squares = vec3(dot(splat.step_x, splat.step_x), 2.0 * dot(splat.step_x, splat.step_y),
                      dot(splat.step_y, splat.step_y));
  float size = splat.lift / splat.radius;
  splat.conic = size * size * (splat.lengthened * squares - vec3(m.x * m.x, 2.0 * m.x * m.y, m.y * m.y)) -
                perspective * squares;
  splat.tilt = -2.0 * m;
  splat.centre = ps_cell_from_pixel(ps_pixel_from_view(p).xy);
  vec2 to_column = vec2(u.lattice.x, -u.lattice.y) * u.focal, to_row = u.lattice.yx * u.focal;
  float area = splat.radius * splat.radius;
  vec2 columns = ps_ellipsoid_ends(dot(to_column, p.xy), area * dot(to_column, to_column), 0.0, p.z, area);
  vec2 rows = ps_ellipsoid_ends(dot(to_row, p.xy), area * dot(to_row, to_row), 0.0, p.z, area);
  vec2 origin = ps_cell_from_pixel(u.principal_point);
  splat.box = vec4(columns.x + origin.x, rows.x + origin.y, columns.y + origin.x, rows.y + origin.y);
  return all(greaterThan(splat.box.zw, vec2(0.0))) && all(lessThan(splat.box.xy, u.cells));
}

// Where the ray through a cell, relative to the centre of the ball, meets it.
PsSplatHit ps_meet_splat(PsUnitSplat splat, vec2 cell)
{
  precise vec2 q = cell.x * splat.step_x + cell.y * splat.step_y;
  precise float along = dot(splat.slopes, q);
  precise float square = ps_is_perspective() ? dot(q, q) : 0.0;
  precise float f = (splat.conic.x * cell.x + splat.conic.y * cell.y + splat.tilt.x) * cell.x +
                    (splat.conic.z * cell.y + splat.tilt.y) * cell.y - splat.lengthened;
  precise float scale = 1.0 / (splat.lengthened + 2.0 * along + square);
  precise float chord = splat.radius * sqrt(max(-f, 0.0));
  precise float middle = splat.lift * (along + square);
  precise float back = -(middle + chord) * scale;
  // Cut open by the near plane, a ball shows its inside.
  back = splat.depth + back < u.near ? (chord - middle) * scale : back;
  PsSplatHit hit;
  hit.depth = splat.depth + back;
  hit.there = f <= 0.0 && hit.depth >= u.near && hit.depth <= u.far;
  hit.aside = q;
  hit.back = back;
  return hit;
}

// Unit normal where a ray meets the ball, in view space.
vec3 ps_splat_normal(PsUnitSplat splat, PsSplatHit hit, vec3 toward)
{
  vec2 across = hit.aside * (ps_is_perspective() ? hit.depth : 1.0) + splat.slopes * hit.back;
  return vec3(across, -hit.back) * (1.0 / splat.radius);
}

// The first and the last cell of a row, relative to the ball's centre, that the ball may cover; wider by rounding.
vec2 ps_row_ends(PsUnitSplat splat, float row)
{
  float b = 0.5 * (splat.conic.y * row + splat.tilt.x);
  float c = (splat.conic.z * row + splat.tilt.y) * row - splat.lengthened;
  float root = sqrt(max(b * b - splat.conic.x * c, 0.0));
  return vec2(-b - root, root - b) / splat.conic.x + vec2(-0.01, 0.01);
}
