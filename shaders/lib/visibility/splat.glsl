// Where rays through sub-samples meet an opaque splat: a ball (an ellipsoid in view space) or an elliptical disk.
// PS_ROUND: all are balls, also in view space. PS_BALL_PAGE: the page holds balls alone, with their radius in the place of the
// normal, and one material. PS_NODES: ellipsoids that stand for several balls, of which a part is covered. PS_PARTLY: of some
// disks or balls, too, a part is covered.

#include "lib/data/splat.glsl"
#include "lib/geometry/ellipsoid_bounds.glsl"
#include "lib/visibility/lattice.glsl"

// Position, and packed normal (-1: a ball).
vec4 ps_splat_head(ivec3 element)
{
  vec4 head = texelFetch(ps_position, element.xy, 0);
#ifdef PS_BALL_PAGE
  head.w = -1.0;
#endif
  return head;
}

// Half-axes, packed major axis, material row.
vec4 ps_splat_extent(ivec3 element)
{
#ifdef PS_BALL_PAGE
  float radius = texelFetch(ps_position, element.xy, 0).w;
  return vec4(radius, radius, 0.0, u.ball_material);
#else
  return texelFetch(ps_extent, element.xy, 0);
#endif
}

#ifdef PS_ROUND
#include "lib/visibility/round_ball.glsl"
#else

// A splat in coordinates in which it is the unit ball, or the unit disk in the plane z = 0. Rays are told apart by their cells,
// relative to that of the splat's centre, so that nothing is lost by rounding far from the eye: the ray at `cell` passes the
// centre's depth at lift * (cell.x * across_x + cell.y * across_y), in the direction along + cell * across.
struct PsUnitSplat {
  bool ball;
  mat3 unit_from_view;
#if defined(PS_NODES) || defined(PS_PARTLY)
  vec3 covered;  // see ps_node_coverage
#endif
#ifdef PS_NODES
  vec3 conic;  // 1 - conic . (x x, x y, y y) is what ps_meet_splat calls outside, with all rays parallel to the one at the centre
  vec2 slope;  // of the depth of the chords' middles, a cell
  float chord;  // half of the one through the centre
  float wide, thinning, thinned_depth;  // see covered.glsl
#endif
  vec2 centre;  // in cells
  float depth;  // of the centre
  float lift;  // the centre's depth, or 1 in a parallel view
  vec3 along, across_x, across_y;
  vec4 box;  // in cells, from the centre: low and high corner
};

struct PsSplatHit {
  bool there;
  float depth;
  vec3 point;  // in the splat's coordinates
#if defined(PS_NODES) || defined(PS_PARTLY)
  float share;  // of the covered fraction of the splat that is covered here
#endif
};

// The least and the greatest value of dot(along, p) / depth over the ellipsoid with the centre p and the shape S, in a parallel
// view without the division.
vec2 ps_extent_along(vec2 along, vec3 p, mat3 shape)
{
  vec2 s = vec2(dot(along, shape[0].xy), dot(along, shape[1].xy));
  return ps_ellipsoid_ends(dot(along, p.xy), dot(s, along), dot(along, shape[2].xy), p.z, shape[2][2]);
}

#if defined(PS_NODES) || defined(PS_PARTLY)
#include "lib/visibility/ranks.glsl"
#include "lib/splat/covered.glsl"
#endif

// False: the splat lies outside of the picture, or is nothing.
bool ps_unit_splat(ivec3 element, out PsUnitSplat splat)
{
  vec4 head = ps_splat_head(element);
  vec4 extent = ps_splat_extent(element);
  mat3 linear = ps_linear(element.z);
  vec3 p = ps_view_from_point(element.z, head.xyz);
  splat.depth = -p.z;
#ifdef PS_NODES
  splat.ball = true;
  vec4 moments = texelFetch(ps_moments, element.xy, 0);
  mat3 axes = ps_node_axes(linear, extent.xyz, moments.xyz);
#else
  float minor = abs(extent.y);
  splat.ball = head.w < 0.0;
  mat3 axes = extent.x * linear;
  if (!splat.ball) {
    vec3 n = ps_unpack_normal(head.w);
#ifdef PS_ELLIPSES
    vec3 major = ps_unpack_normal(extent.z);
#else
    vec3 major = abs(n.x) < 0.5 ? vec3(1.0, 0.0, 0.0) : vec3(0.0, 1.0, 0.0);
#endif
    major = normalize(major - dot(major, n) * n);
    axes = linear * mat3(extent.x * major, minor * cross(n, major), extent.x * n);
  }
#endif
  mat3 cofactors = mat3(cross(axes[1], axes[2]), cross(axes[2], axes[0]), cross(axes[0], axes[1]));
  float volume = dot(axes[0], cofactors[0]);
  mat3 shape = axes * transpose(axes);
  if (!splat.ball) {
    shape = mat3(axes[0], axes[1], vec3(0.0)) * transpose(mat3(axes[0], axes[1], vec3(0.0)));
  }
  float deep = sqrt(shape[2][2]);
  if (!(abs(volume) > 1e-37) || splat.depth + deep < u.near || splat.depth - deep > u.far) {
    return false;
  }
  splat.unit_from_view = transpose(cofactors) * (1.0 / volume);
  bool perspective = ps_is_perspective();
#ifdef PS_NODES
  vec3 sight = perspective ? normalize(p) : vec3(0.0, 0.0, -1.0);
  float silhouette = abs(volume) * length(splat.unit_from_view * sight);
  splat.covered = ps_node_coverage(head.xyz, element.z, ps_node_depth(moments.w, linear, silhouette), -1.0 - head.w);
#endif
#ifdef PS_PARTLY
  float fraction = 1.0 - fract(extent.w) / PS_COVERED;
  splat.covered = ps_covered_ranks(head.xyz, element.z, fraction);
#endif
  // From cells to slopes, or positions in a parallel view: the lattice's matrix is a rotation times a scale.
  float square = dot(u.lattice.xy, u.lattice.xy);
  vec2 step_x = vec2(u.lattice.x, -u.lattice.y) / (square * u.focal), step_y = u.lattice.yx / (square * u.focal);
  splat.lift = perspective ? splat.depth : 1.0;
  vec3 middle = perspective ? vec3(p.xy / splat.depth, -1.0) : vec3(0.0, 0.0, -1.0);
  splat.across_x = splat.unit_from_view * vec3(step_x, 0.0);
  splat.across_y = splat.unit_from_view * vec3(step_y, 0.0);
  splat.along = splat.unit_from_view * middle;
#ifdef PS_NODES
  vec3 column = splat.lift * splat.across_x, row = splat.lift * splat.across_y;
  float square_along = dot(splat.along, splat.along);
  splat.slope = vec2(dot(column, splat.along), dot(row, splat.along)) / square_along;
  splat.conic = vec3(dot(column, column), 2.0 * dot(column, row), dot(row, row)) -
                square_along * vec3(splat.slope.x * splat.slope.x, 2.0 * splat.slope.x * splat.slope.y, splat.slope.y * splat.slope.y);
  splat.chord = inversesqrt(square_along);
  float area = inversesqrt(max(splat.conic.x * splat.conic.z - 0.25 * splat.conic.y * splat.conic.y, 1e-30)) / square;
  splat.wide = ps_node_width(sqrt(area));
  splat.thinning = ps_node_thinning(splat.covered.x / float(PS_RANKS), splat.wide);
  splat.thinned_depth = ps_thinned_depth(splat.covered.x / float(PS_RANKS));
  shape *= splat.thinning > 0.0 ? PS_WIDER : 1.0;
#endif
  splat.centre = ps_cell_from_pixel(ps_pixel_from_view(p).xy);
  vec2 to_column = vec2(u.lattice.x, -u.lattice.y) * u.focal, to_row = u.lattice.yx * u.focal;
  vec2 columns = ps_extent_along(to_column, p, shape);
  vec2 rows = ps_extent_along(to_row, p, shape);
  vec2 origin = vec2(dot(vec2(u.lattice.x, -u.lattice.y), u.principal_point), dot(u.lattice.yx, u.principal_point)) +
                u.lattice.zw;
  splat.box = vec4(columns.x + origin.x, rows.x + origin.y, columns.y + origin.x, rows.y + origin.y);
  return all(greaterThan(splat.box.zw, vec2(0.0))) && all(lessThan(splat.box.xy, u.cells));
}

// Where the ray through a cell, relative to the centre of the splat, meets it.
PsSplatHit ps_meet_splat(PsUnitSplat splat, vec2 cell)
{
#ifdef PS_NODES
  precise float outside = 1.0 - (splat.conic.x * cell.x * cell.x + splat.conic.y * cell.x * cell.y + splat.conic.z * cell.y * cell.y);
  precise float back = dot(splat.slope, cell), chord = splat.chord * sqrt(max(outside, 0.0));
  precise float depth = splat.depth - back - chord;
  PsSplatHit hit;
  hit.depth = depth;
  hit.point = splat.lift * (cell.x * splat.across_x + cell.y * splat.across_y) - back * splat.along;
  hit.share = 1.0;
  // A loop of one turn or none, for a software renderer runs both sides of every branch.
  for (int i = 0; i < (splat.wide > 0.0 ? 1 : 0); i++) {
    float q = 1.0 - outside, left = max(1.0 - q / PS_WIDER, 0.0);
    if (splat.thinning > 0.0) {
      float even = outside >= 0.0 ? 1.0 : 0.0;
      float thinned = (1.0 - exp(-splat.thinned_depth * left * left)) * float(PS_RANKS) / splat.covered.x;
      hit.share = mix(even, thinned, splat.thinning);
      outside = left > 0.0 ? 0.0 : -1.0;
    }
    vec2 at = ps_scattered(floor(0.5 * floor(cell + splat.centre)), splat.covered.y / float(PS_RANKS));
    if (fract(3.0 * at.x + 5.0 * at.y) < splat.wide) {
      float covered = splat.covered.x / float(PS_RANKS);
      at.x *= 1.0 - PS_RIMS_HIDDEN * covered * covered;
      float turn = 6.28318531 * at.y, unit = splat.chord * inversesqrt(max(q, 1e-9));
      hit.point = sqrt(at.x) * (cos(turn) * hit.point * inversesqrt(max(q, 1e-9)) + sin(turn) * unit * cross(splat.along, hit.point));
      chord = splat.chord * sqrt(1.0 - at.x);
    } else {
      hit.point *= min(inversesqrt(max(q, 1e-9)), 1.0);
    }
  }
  hit.point -= chord * splat.along;
  hit.there = outside >= 0.0 && depth >= u.near && depth <= u.far;
  return hit;
#else
  precise vec3 across = cell.x * splat.across_x + cell.y * splat.across_y;
  precise vec3 along = splat.along + (ps_is_perspective() ? 1.0 : 0.0) * across;
  precise vec3 point = splat.lift * across;
  bool ball = splat.ball;
  precise float square = dot(along, along);
  precise float back = ball ? dot(point, along) / square : point.z / along.z;
  point -= back * along;
  precise float outside = 1.0 - (ball ? dot(point, point) : dot(point.xy, point.xy));
  precise float chord = ball ? sqrt(max(outside, 0.0) / square) : 0.0;
  precise float depth = splat.depth - back - chord;
  // Cut open by the near plane, a ball shows its inside.
  bool open = depth < u.near;
  depth = open ? splat.depth - back + chord : depth;
  PsSplatHit hit;
  hit.there = outside >= 0.0 && depth >= u.near && depth <= u.far;
  hit.depth = depth;
  hit.point = point + (open ? chord : -chord) * along;
#ifdef PS_PARTLY
  hit.share = 1.0;
#endif
  return hit;
#endif
}

// Unit normal where a ray meets the splat, in view space; that of a disk is turned to the eye.
vec3 ps_splat_normal(PsUnitSplat splat, PsSplatHit hit, vec3 toward)
{
#ifdef PS_NODES
  return ps_node_normal(splat.unit_from_view, hit.point, normalize(toward), splat.covered.z);
#else
  vec3 n = splat.ball ? hit.point * splat.unit_from_view : vec3(0.0, 0.0, 1.0) * splat.unit_from_view;
  n = ps_direction(n, vec3(0.0, 0.0, 1.0));
  return !splat.ball && dot(n, toward) > 0.0 ? -n : n;
#endif
}

#endif

#ifdef PS_CULL
// Whether the splat turns its back to the eye, and its material hides that.
bool ps_is_culled(ivec3 element)
{
  int material = int(ps_splat_extent(element).w);
  float code = ps_splat_head(element).w;
  if (code < 0.0 || texelFetch(ps_materials, ivec2(2, material), 0).x <= 0.5) {
    return false;
  }
  vec3 p = ps_view_from_point(element.z, texelFetch(ps_position, element.xy, 0).xyz);
  vec3 normal = ps_view_normal(ps_linear(element.z), ps_unpack_normal(code));
  return dot(normal, ps_is_perspective() ? -p : vec3(0.0, 0.0, 1.0)) < 0.0;
}
#endif
