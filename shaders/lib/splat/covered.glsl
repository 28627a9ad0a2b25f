#define PS_CLOSED 0.98  // covered fraction from which on nodes have no holes

// Nodes that stand for several balls: ellipsoids with the moments of these, of whose silhouettes a fraction is covered.
// Tests: tests/render/visibility/test_nodes.py.

#ifdef PS_NODES
// Half-axes in view space, the columns of a lower triangular matrix, of four times the covariance of a node's balls in object
// space: xx, xy, xz and yy, yz, zz. By Cholesky's decomposition.
mat3 ps_node_axes(mat3 linear, vec3 first, vec3 second)
{
  mat3 shape = linear * mat3(first, vec3(first.y, second.xy), vec3(first.z, second.yz)) * transpose(linear);
  float xx = sqrt(shape[0][0]);
  vec2 below = shape[0].yz / xx;
  float yy = sqrt(max(shape[1][1] - below.x * below.x, 0.0));
  float zy = (shape[1][2] - below.x * below.y) / yy;
  float zz = sqrt(max(shape[2][2] - below.y * below.y - zy * zy, 0.0));
  return mat3(xx, below, 0.0, yy, zy, 0.0, 0.0, zz);
}

// The areas of a node's balls over its silhouette (in units of pi), both in view space.
float ps_node_depth(float area, mat3 linear, float silhouette)
{
  float volume = abs(dot(linear[0], cross(linear[1], linear[2])));
  return area * pow(volume, 2.0 / 3.0) / (3.14159265 * silhouette);
}
#endif

// A number in [0, 1) of each node of each instance, that stays.
float ps_node_number(vec3 position, int instance)
{
  uvec3 bits = floatBitsToUint(position);
  uint h = bits.x * 0x9E3779B1u ^ bits.y * 0x85EBCA77u ^ bits.z * 0xC2B2AE3Du ^ uint(instance) * 0x27D4EB2Fu;
  h = (h ^ (h >> 15u)) * 0x2C1B3C6Du;
  h = (h ^ (h >> 12u)) * 0x297A2D39u;
  return float((h ^ (h >> 15u)) >> 8u) / 16777216.0;
}

// How many of a pixel's sub-samples a fraction of a splat covers, and the rank of the first.
vec3 ps_covered_ranks(vec3 position, int instance, float covered)
{
  // From lattice to lattice ranks, and what is left of them, go on by the golden ratio.
  const float step = floor(0.618033989 * float(PS_RANKS)) + 0.618033989;
  float first = float(PS_RANKS) * ps_node_number(position, instance) + step * float(u.sample_index);
  return vec3(float(PS_RANKS) * (covered > PS_CLOSED ? 1.0 : covered), mod(first, float(PS_RANKS)), 0.0);
}

#ifdef PS_NODES
// How many of a pixel's sub-samples a node of the summed depth covers, a fraction; the rank of the first; and how far its balls
// are seen as such, in 0 to 1: less where they hide more than half of each other. See core/lod/balls/tree.py, saturation.
vec3 ps_node_coverage(vec3 position, int instance, float depth, float saturation)
{
  float covered = depth > 0.01 ? 1.0 - exp(-depth * (1.0 + saturation * depth)) : depth;
  float free = min(2.0 * covered / max(depth, 0.01), 1.0);
  return vec3(ps_covered_ranks(position, instance, covered).xy, free * free);
}
#endif

#ifdef PS_NODES
// How far, in 0 to 1, a node of a covered fraction thins out from its middle to its rim. At q of its squared half-axes it is then
// covered by 1 - exp(-d (1 - q / PS_WIDER)^2), in PS_WIDER times its area, in the mean by the fraction. Depths of nodes of even
// square cells add up evenly: the Fourier transform of that, J3(x) / x^3, is zero at the first harmonic of the cells. Nodes that are
// nearly closed do not, lest surfaces have holes. `wide`: see ps_node_width.
float ps_node_thinning(float covered, float wide)
{
  return clamp((PS_CLOSED - covered) / (PS_CLOSED - 0.7), 0.0, 1.0) * wide;
}

// How wide a node of a radius in pixels is, in 0 to 1: where cells are no wider than pixels nobody can tell.
float ps_node_width(float radius)
{
  return clamp(radius - 1.0, 0.0, 1.0);
}

// Of sheets of nodes of which a fraction f is covered, f^2 times this is the share of the silhouettes by which neighbours hide
// rims: measured by the light of a sun on nodes of a pixel, in which no order is seen.
#define PS_RIMS_HIDDEN 0.3

// Where on its silhouette one of a wide node's balls is seen in a cell: the square of the distance from the middle, and the angle
// over that of a turn. Those of neighbouring cells are spread evenly (the sequence R4 of Roberts 2018), so that no side of the
// node is brighter than the other.
vec2 ps_scattered(vec2 cell, float number)
{
  return fract(vec2(dot(cell, vec2(0.8566749, 0.7338918)), dot(cell, vec2(0.6287068, 0.5385973))) + number);
}

// The depth d in the middle of a node that thins out: of the mean, PS_WIDER (1 - sqrt(pi / (4 d)) erf(sqrt(d))), the inverse, to 0.13 %.
float ps_thinned_depth(float covered)
{
  return covered * (1.4582 + covered * (0.5818 + covered * (0.68 + covered * (0.7351 * covered - 0.5896))));
}
#endif

// Whether a node covers a cell, by `share` of the fraction. Ranks are such that consecutive ones are
// spread over the pixel. The covered ones are consecutive from a real number on, modulo their count, so that the mean over all
// numbers is the fraction.
bool ps_is_covered(vec3 covered, float share, ivec2 cell)
{
  float rank = ps_cell_rank(cell) + covered.y;
  return (rank < float(PS_RANKS) ? rank : rank - float(PS_RANKS)) < covered.x * share;
}

// A normal of one of a node's balls, seen along `sight`: normals of balls are spread over the node as they are over a ball.
// Of balls that hide each other, only parts are seen, about the node's own normal.
vec3 ps_node_normal(mat3 unit_from_view, vec3 point, vec3 sight, float free)
{
  vec3 along = normalize(unit_from_view * sight);
  vec3 aside = point - dot(point, along) * along;
  vec3 across = inverse(unit_from_view) * aside;
  across -= dot(across, sight) * sight;
  float size = length(across);
  // That of the ellipsoid, turned to its shortest half-axis, for the surface of flat nodes is flatter than they are.
  vec3 own = normalize(point * unit_from_view);
  own = normalize((unit_from_view * own) * unit_from_view);
  own *= dot(own, sight) > 0.0 ? -1.0 : 1.0;
  across *= size > 0.0 ? length(aside) / size : 0.0;
  vec3 ball = across - sqrt(max(1.0 - dot(across, across), 0.0)) * sight;
  return ps_direction(mix(own, ball, free), ball);
}
