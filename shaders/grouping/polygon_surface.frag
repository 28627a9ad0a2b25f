// Attributes of the triangle that stands for a group of sub-samples, where its sub-sample meets it: one texel of the
// G-buffer. PS_AVERAGE: what pictures show is the mean over the group's sub-samples. PS_LEVELS: and over the footprints of
// these, where one spans more than a texel. PS_PLACED_...: graphs were evaluated at the point, over its footprint.

#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"
#include "lib/data/pack.glsl"
#include "lib/geometry/instance.glsl"
#include "lib/visibility/block.glsl"
#include "lib/visibility/leader.glsl"

#define PS_ROUNDED_NORMALS 1e-3  // radians

// The point, as lib/data/polygon.glsl wants it.
vec3 v_normal;
vec2 v_uv;
vec4 v_color;
vec2 v_surface;
vec3 v_emission;

#ifdef PS_BLOCKS
int material_row;
#define PS_MATERIAL material_row
#endif

#include "lib/data/polygon.glsl"

#if defined(PS_SPREAD) && !defined(PS_PLACED_NORMAL)
#define PS_KEYED
#endif
#if defined(PS_AVERAGE) || defined(PS_KEYED)
#include "lib/visibility/groups.glsl"
#include "lib/visibility/lattice.glsl"
#include "lib/visibility/surface_key.glsl"
#endif
#ifdef PS_SPREAD
#include "lib/visibility/normal_spread.glsl"
#endif

// Weights of a triangle's corners at a point of it, which the rasteriser has found: q, from the first corner, as a and b, which
// lead to the others.
vec3 ps_weights(vec3 a, vec3 b, vec3 q)
{
  float aa = dot(a, a), ab = dot(a, b), bb = dot(b, b), qa = dot(q, a), qb = dot(q, b);
  // No products of two of these, which would leave float32's range where a unit is large.
  vec2 share = ab / max(vec2(bb, aa), vec2(1e-37)), of_edges = vec2(aa, bb) - share * ab;
  bool thin = min(of_edges.x, of_edges.y) <= 0.0;
  vec2 w = thin ? vec2(1.0 / 3.0) : (vec2(qa, qb) - share * vec2(qb, qa)) / of_edges;
  vec3 weights = clamp(vec3(1.0 - w.x - w.y, w), vec3(0.0), vec3(1.0));
  return weights / (weights.x + weights.y + weights.z);
}

#ifdef PS_LEVELS
// Changes of UV from a pixel to the next, along x and y, at a point of a triangle with these edges and changes along them.
mat2 ps_uv_from_pixel(vec3 a, vec3 b, vec2 along_a, vec2 along_b, vec3 position)
{
  vec3 toward = ps_is_perspective() ? position : vec3(0.0, 0.0, -1.0);
  vec3 plane = cross(a, b);
  float square = max(dot(plane, plane), 1e-37);
  vec3 by_a = cross(b, plane) / square, by_b = cross(plane, a) / square;  // gradients of the weights
  // Rays that move across meet the plane farther along.
  float towards = dot(plane, toward), least = 1e-4 * sqrt(square * dot(toward, toward));
  vec3 farther = toward / (towards < 0.0 ? min(towards, -least) : max(towards, least));
  vec2 size = (ps_is_perspective() ? -position.z : 1.0) / u.focal;
  vec3 x = size.x * (vec3(1.0, 0.0, 0.0) - farther * plane.x), y = size.y * (vec3(0.0, 1.0, 0.0) - farther * plane.y);
  return mat2(along_a * dot(by_a, x) + along_b * dot(by_b, x), along_a * dot(by_a, y) + along_b * dot(by_b, y));
}

// Of a point of such a triangle.
PsFootprint ps_member_footprint(vec3 a, vec3 b, vec2 along_a, vec2 along_b, vec3 position)
{
  mat2 uv_from_pixel = ps_uv_from_pixel(a, b, along_a, along_b, position);
  float side = ps_footprint_side(u.footprint, uv_from_pixel, ps_patch_area(along_a, along_b));
  return ps_footprint(side * uv_from_pixel[0], side * uv_from_pixel[1], ps_texels());
}
#endif

#if defined(PS_AVERAGE) || defined(PS_LEVELS)
// Texels that a pixel spans at most, of a triangle with these edges and changes of UV along them, at depth d.
float ps_texels_of_pixel(vec3 a, vec3 b, vec2 along_a, vec2 along_b, vec3 toward, float d)
{
  vec3 plane = cross(a, b);
  float square = max(dot(plane, plane), 1e-37);
  vec3 by_a = cross(b, plane) / square, by_b = cross(plane, a) / square;  // gradients of the weights
  vec2 steps = ps_texels() * vec2(length(along_a.x * by_a + along_b.x * by_b), length(along_a.y * by_a + along_b.y * by_b));
  float cosine = abs(dot(plane, toward)) * inversesqrt(square * dot(toward, toward));
  return max(steps.x, steps.y) * ps_pixel_size(d) / max(cosine, 1e-4);
}
#endif

#ifdef PS_AVERAGE
#define PS_MAGNIFIED 0.5  // texels that a pixel spans: up to here colours change linearly over it

// A point that a cell shows of a triangle, whose edges are a and b; how UV changes along these.
struct PsMember {
  vec3 position, a, b;
  vec2 uv, along_a, along_b;
};

PsMember ps_member(int slot, int triangle, ivec2 cell)
{
  PsMember m;
  float d = uintBitsToFloat(texelFetch(ps_depths, cell, 0).x) + u.near;
  m.position = ps_view_from_pixel(ps_pixel_from_cell(vec2(cell) + 0.5), d);
  ivec2 first = ps_texel(3 * triangle), second = ps_texel(3 * triangle + 1), third = ps_texel(3 * triangle + 2);
  vec3 p = ps_view_from_point(slot, texelFetch(ps_corner, first, 0).xyz);
  m.a = ps_view_from_point(slot, texelFetch(ps_corner, second, 0).xyz) - p;
  m.b = ps_view_from_point(slot, texelFetch(ps_corner, third, 0).xyz) - p;
  vec3 weights = ps_weights(m.a, m.b, m.position - p);
  vec2 uv = texelFetch(ps_corner_uv, first, 0).xy;
  m.along_a = texelFetch(ps_corner_uv, second, 0).xy - uv;
  m.along_b = texelFetch(ps_corner_uv, third, 0).xy - uv;
  m.uv = uv + weights.y * m.along_a + weights.z * m.along_b;
  return m;
}

#ifdef PS_LEVELS
void ps_filtered_member(inout PsSurfel s, PsMember m)
{
  v_footprint = ps_member_footprint(m.a, m.b, m.along_a, m.along_b, m.position);
  v_uv = m.uv;
  ps_filtered_attributes(s);
}
#endif

void ps_add_shown(inout PsSurfel sum, inout float count, PsSurfel one)
{
#ifdef PS_COLOR
  sum.color += one.color;
#endif
#ifdef PS_SURFACE
  sum.normal.w += one.normal.w;
#endif
#ifdef PS_EMISSION
  sum.emission += one.emission;
#endif
  count += 1.0;
}
#endif

#if defined(PS_BAKED_NORMAL) || defined(PS_BAKED_HEIGHT)
#define PS_BENT
#if defined(PS_LEVELS) && defined(PS_SPREAD)
#define PS_FILTERED_BENDS  // over the footprints of sub-samples, where one spans more than a texel
#endif
#endif

#if defined(PS_AVERAGE) || (defined(PS_SPREAD) && defined(PS_BENT))
// Whether a sub-sample shows a triangle of an instance that is drawn as the leader's. `triangle`: in, its number among those
// of the draw; out, that in the mesh.
bool ps_is_like(int slot, inout int triangle)
{
#ifdef PS_BLOCKS
  int number = triangle;
  vec4 block = ps_block(clamp(number, 0, u.triangles - 1));
  triangle = int(block.x) + (number & PS_BLOCK_MASK);
  return number >= 0 && number < u.triangles && int(block.z) == slot;
#else
  triangle -= slot * u.triangles;
  return triangle >= u.first_triangle && triangle < u.last_triangle;
#endif
}
#endif

#ifdef PS_BENT
// What pictures show of a normal.
struct PsBend {
#ifdef PS_BAKED_NORMAL
  vec3 normal;  // in tangent space
#endif
#ifdef PS_BAKED_HEIGHT
  vec3 slope;  // of ps_slope
#endif
#ifdef PS_FILTERED_BENDS
  float within;  // 1 minus the squared length of the normals' mean over a footprint
#ifdef PS_BAKED_HEIGHT
  vec2 slopes;  // variances, along u and v
#endif
#endif
};

PsBend ps_bend(vec2 at)
{
  PsBend bend;
#ifdef PS_BAKED_NORMAL
  bend.normal = ps_picture(ps_baked_normal, at).xyz;
#endif
#ifdef PS_BAKED_HEIGHT
  bend.slope = ps_slope(at);
#endif
#ifdef PS_FILTERED_BENDS
  bend.within = 0.0;
#ifdef PS_BAKED_HEIGHT
  bend.slopes = vec2(0.0);
#endif
#endif
  return bend;
}

#ifdef PS_FILTERED_BENDS
// The mean over a footprint.
PsBend ps_filtered_bend(vec2 at, PsFootprint footprint)
{
  PsBend bend = ps_bend(at);
#ifdef PS_BAKED_NORMAL
  vec3 mean = ps_filtered_normal(at, footprint);  // z: 1 minus it
  bend.normal = vec3(mean.xy, 1.0 - mean.z);
  bend.within = max(2.0 * mean.z - mean.z * mean.z - dot(mean.xy, mean.xy), 0.0);
#endif
#ifdef PS_BAKED_HEIGHT
  vec4 slopes = ps_filtered_slope(at, footprint);
  bend.slope.xy = slopes.xy;
  bend.slopes = max(slopes.zw - slopes.xy * slopes.xy, vec2(0.0));
#endif
  return bend;
}
#endif
#endif

#ifdef PS_NORMAL
struct PsCorners {
  vec4 texels[3];  // the last is the packed normal
  vec3 p[3];  // in view space
};

// How a point of a triangle is shaded.
struct PsShown {
  vec3 normal;  // on the side of the corners' normals
  vec3 plane;
  bool turned;  // the other side is seen
#ifdef PS_FILTERED_BENDS
  float within;  // of PsBend, with that of slopes
#endif
};

#ifdef PS_BENT
PsShown ps_shown(int slot, PsCorners corners, vec2 uv[3], vec3 weights, PsBend bend, vec3 position)
#else
PsShown ps_shown(int slot, PsCorners corners, vec3 weights, vec3 position)
#endif
{
  vec3 a = corners.p[1] - corners.p[0], b = corners.p[2] - corners.p[0];
  PsShown shown;
  shown.plane = ps_direction(cross(a, b), vec3(0.0, 0.0, 1.0));
  shown.turned = dot(shown.plane, ps_is_perspective() ? position : vec3(0.0, 0.0, -1.0)) > 0.0;
  mat3 linear = ps_linear(slot);
  vec3 normal = vec3(0.0);
#ifdef PS_BAKED_NORMAL
  // In object space, where tangents are made.
  for (int i = 0; i < 3; i++) {
    normal += weights[i] * ps_unpack_normal(corners.texels[i].w);
  }
  vec3 first = corners.texels[0].xyz;
  normal = ps_bent(ps_direction(normal, vec3(0.0, 0.0, 1.0)), bend.normal,
                   corners.texels[1].xyz - first, corners.texels[2].xyz - first, uv[1] - uv[0], uv[2] - uv[0]);
  shown.normal = ps_view_normal(linear, normal);
#else
  for (int i = 0; i < 3; i++) {
    normal += weights[i] * ps_view_normal(linear, ps_unpack_normal(corners.texels[i].w));
  }
  shown.normal = ps_direction(normal, vec3(0.0, 0.0, 1.0));
#endif
#ifdef PS_BAKED_HEIGHT
  mat2x3 tilts = ps_tilts(shown.normal, a, b, uv[1] - uv[0], uv[2] - uv[0]);
  shown.normal = ps_raised(shown.normal, bend.slope, shown.turned ? -1.0 : 1.0, tilts);
#endif
#ifdef PS_FILTERED_BENDS
  shown.within = bend.within;
#ifdef PS_BAKED_HEIGHT
  // As means of unit normals do, of which a variance of slopes is the squared length's missing part over the rest.
  float strength = clamp(bend.slope.z, 0.0, 1.0);
  vec2 size2 = vec2(dot(tilts[0], tilts[0]), dot(tilts[1], tilts[1]));
  shown.within = 1.0 - (1.0 - bend.within) / (1.0 + strength * strength * dot(bend.slopes, size2));
#endif
#endif
  return shown;
}

// How far above a point of a triangle the surface bulges that the corners' normals tell of, times the length of their mean: the
// least height of the planes across these (Hanika 2021), but at least half of what its parabola rises, as in Cycles.
float ps_bulge(int slot, PsCorners corners, vec3 weights, vec3 position, bool turned)
{
  mat3 linear = ps_linear(slot);
  vec3 normal = vec3(0.0);
  float lowest = 1e30, parabola = 0.0, far = 0.0;
  for (int i = 0; i < 3; i++) {
    vec3 own = ps_view_normal(linear, ps_unpack_normal(corners.texels[i].w)), away = corners.p[i] - position;
    float height = turned ? -dot(away, own) : dot(away, own);
    normal += weights[i] * own;
    parabola += weights[i] * height;
    lowest = min(lowest, height);
    far = max(far, dot(away, away));
  }
  // Normals are rounded.
  return max(max(lowest, 0.5 * parabola) - PS_ROUNDED_NORMALS * sqrt(far), 0.0) * length(normal);
}

#if defined(PS_SPREAD) && defined(PS_BENT)
// How a sub-sample of a group shows a triangle, whose normal pictures bend.
struct PsBentMember {
  vec3 position;
  PsCorners corners;
  vec2 uv[3];
  vec3 weights;
  vec2 at;
};

PsBentMember ps_bent_member(PsLeader leader, int slot, int triangle, ivec2 cell, int number)
{
  const vec2 offsets[PS_SUB_SAMPLES] = PS_OFFSETS;
  float d = uintBitsToFloat(texelFetch(ps_depths, cell, 0).x) + u.near;
  PsBentMember m;
  m.position = ps_view_from_pixel(vec2(leader.pixel) + 0.5 + offsets[number], d);
  for (int i = 0; i < 3; i++) {
    ivec2 texel = ps_texel(3 * triangle + i);
    m.corners.texels[i] = texelFetch(ps_corner, texel, 0);
    m.corners.p[i] = ps_view_from_point(slot, m.corners.texels[i].xyz);
    m.uv[i] = texelFetch(ps_corner_uv, texel, 0).xy;
  }
  m.weights = ps_weights(m.corners.p[1] - m.corners.p[0], m.corners.p[2] - m.corners.p[0], m.position - m.corners.p[0]);
  m.at = m.weights.x * m.uv[0] + m.weights.y * m.uv[1] + m.weights.z * m.uv[2];
  return m;
}

void ps_add_bent(inout PsNormals normals, PsShown shown)
{
#ifdef PS_FILTERED_BENDS
  normals.sum += (shown.turned ? -1.0 : 1.0) * sqrt(max(1.0 - shown.within, 0.0)) * shown.normal;
  normals.within += shown.within;
#else
  normals.sum += shown.turned ? -shown.normal : shown.normal;
#endif
  normals.count += 1.0;
}

// Shades a group by the mean of its sub-samples' normals, which pictures bend, and keeps their spread. `minified`: a
// footprint spans more than a texel.
void ps_shade_by_bends(inout PsSurfel s, PsLeader leader, int slot, bool minified)
{
  uvec2 codes = uvec2(texelFetch(ps_first, leader.pixel, 0).x, texelFetch(ps_second, leader.pixel, 0).x);
  ivec2 middle = ps_central_cell(leader.pixel);
  PsNormals normals = PsNormals(vec3(0.0), 0.0, 0.0);
  uvec2 whole = ps_group_members(codes, uint(leader.layer));
  for (uvec2 members = minified ? uvec2(0u) : whole; (members.x | members.y) != 0u;) {
    int number;
    ivec2 cell = middle + ps_next_member(members, number);
    int triangle = int(texelFetch(ps_ids, cell, 0).x & ~PS_RASTERISED) - u.first_id;
    if (ps_is_like(slot, triangle)) {
      PsBentMember m = ps_bent_member(leader, slot, triangle, cell, number);
      ps_add_bent(normals, ps_shown(slot, m.corners, m.uv, m.weights, ps_bend(m.at), m.position));
    }
  }
#ifdef PS_FILTERED_BENDS
  for (uvec2 members = minified ? whole : uvec2(0u); (members.x | members.y) != 0u;) {
    int number;
    ivec2 cell = middle + ps_next_member(members, number);
    int triangle = int(texelFetch(ps_ids, cell, 0).x & ~PS_RASTERISED) - u.first_id;
    if (ps_is_like(slot, triangle)) {
      PsBentMember m = ps_bent_member(leader, slot, triangle, cell, number);
      vec3 a = m.corners.p[1] - m.corners.p[0], b = m.corners.p[2] - m.corners.p[0];
      PsFootprint footprint = ps_member_footprint(a, b, m.uv[1] - m.uv[0], m.uv[2] - m.uv[0], m.position);
      PsBend bend = ps_filtered_bend(m.at, footprint);
      ps_add_bent(normals, ps_shown(slot, m.corners, m.uv, m.weights, bend, m.position));
    }
  }
#endif
  s.normal.xyz = ps_direction(normals.sum, s.normal.xyz);
  s.centre.y = ps_normal_spread(normals);
}
#endif
#endif

void main()
{
  PsLeader leader = ps_leader(ivec2(gl_FragCoord.xy));
  int number = leader.index - u.first_id;
#if defined(PS_BLOCKS)
  if (number < 0 || number >= u.triangles) {
    discard;
  }
  vec4 block = ps_block(number);
  int slot = int(block.z), triangle = int(block.x) + (number & PS_BLOCK_MASK);
  material_row = int(block.w);
#else
#ifdef PS_ONE_INSTANCE
  int slot = 0, triangle = number;  // software renderers divide integers one by one
  bool there = number >= 0 && number < u.triangles;
#else
  int slot = number / u.triangles, triangle = number - slot * u.triangles;
  bool there = number >= 0 && slot < u.slots;
#endif
  bool mine = triangle >= u.first_triangle && triangle < u.last_triangle;
  if (!there || !mine) {
    discard;
  }
#endif
  ivec2 texels[3] = ivec2[3](ps_texel(3 * triangle), ps_texel(3 * triangle + 1), ps_texel(3 * triangle + 2));
  vec4 corners[3];
  vec3 p[3];
  for (int i = 0; i < 3; i++) {
    corners[i] = texelFetch(ps_corner, texels[i], 0);
    p[i] = ps_view_from_point(slot, corners[i].xyz);
  }
  vec3 a = p[1] - p[0], b = p[2] - p[0];
  vec3 weights = ps_weights(a, b, leader.position - p[0]);
#ifdef PS_UV
  vec2 uv[3] = vec2[3](texelFetch(ps_corner_uv, texels[0], 0).xy, texelFetch(ps_corner_uv, texels[1], 0).xy,
                       texelFetch(ps_corner_uv, texels[2], 0).xy);
  v_uv = weights.x * uv[0] + weights.y * uv[1] + weights.z * uv[2];
#endif
#if defined(PS_AVERAGE) || defined(PS_LEVELS)
  vec3 toward = ps_is_perspective() ? leader.position : vec3(0.0, 0.0, -1.0);
  float spanned = ps_texels_of_pixel(a, b, uv[1] - uv[0], uv[2] - uv[0], toward, -leader.position.z);
#endif
#ifdef PS_CORNER_COLOR
  v_color = weights.x * texelFetch(ps_corner_color, texels[0], 0) + weights.y * texelFetch(ps_corner_color, texels[1], 0) +
            weights.z * texelFetch(ps_corner_color, texels[2], 0);
#elif defined(PS_PLACED_COLOR)
  v_color = texelFetch(ps_placed_color, leader.texel, 0);
#endif
#ifdef PS_CORNER_SURFACE
  v_surface = weights.x * texelFetch(ps_corner_surface, texels[0], 0).xy +
              weights.y * texelFetch(ps_corner_surface, texels[1], 0).xy +
              weights.z * texelFetch(ps_corner_surface, texels[2], 0).xy;
#elif defined(PS_PLACED_SURFACE)
  v_surface = texelFetch(ps_placed_surface, leader.texel, 0).xy;
#endif
#ifdef PS_CORNER_EMISSION
  v_emission = weights.x * texelFetch(ps_corner_emission, texels[0], 0).rgb +
               weights.y * texelFetch(ps_corner_emission, texels[1], 0).rgb +
               weights.z * texelFetch(ps_corner_emission, texels[2], 0).rgb;
#elif defined(PS_PLACED_EMISSION)
  v_emission = texelFetch(ps_placed_emission, leader.texel, 0).rgb;
#endif
  float material = float(PS_MATERIAL);
  PsSurfel s = ps_empty();
  s.centre = vec4(-leader.position.z, 0.0, 0.0, PS_POLYGON);
#ifdef PS_ONE_INSTANCE
  vec2 about = vec2(u.holdout, u.instance);
#else
  vec2 about = ps_instance_row(slot, 3).xy;
#endif
  s.shape = vec4(leader.offset, 0.0, about.x > 1.5 ? PS_MATTE : about.x > 0.5 ? -1.0 - material : material);
#ifdef PS_NORMAL
  PsCorners own = PsCorners(corners, p);
#ifdef PS_BENT
  PsShown shown = ps_shown(slot, own, uv, weights, ps_bend(v_uv), leader.position);
#else
  PsShown shown = ps_shown(slot, own, weights, leader.position);
#endif
#ifdef PS_PLACED_NORMAL
  vec4 placed = texelFetch(ps_placed_normal, leader.texel, 0);  // and the variance of its slopes
  shown.normal = ps_view_normal(ps_linear(slot), placed.xyz);
#ifdef PS_SPREAD
  s.centre.y = placed.w;
#endif
#endif
  s.normal.xyz = shown.normal;
  s.shape.z = ps_bulge(slot, own, weights, leader.position, shown.turned) / ps_pixel_size(s.centre.x);
  ps_seen_from(s, shown.plane, shown.turned);
#if defined(PS_FILTERED_BENDS)
  ps_shade_by_bends(s, leader, slot, spanned * u.footprint > 1.0);
#elif defined(PS_SPREAD) && defined(PS_BENT)
  ps_shade_by_bends(s, leader, slot, false);
#elif defined(PS_KEYED)
  ps_shade_by_keys(s, leader.pixel, leader.layer);
#endif
#endif
  ps_polygon_attributes(s);
#ifdef PS_AVERAGE
  uvec2 codes = uvec2(texelFetch(ps_first, leader.pixel, 0).x, texelFetch(ps_second, leader.pixel, 0).x);
  ivec2 middle = ps_central_cell(leader.pixel);
  PsSurfel sum = ps_empty();
  float count = 0.0;
#ifdef PS_PICTURE_CLOSEST
  spanned = max(spanned, 1.0);  // colours jump
#endif
  uvec2 whole = spanned > PS_MAGNIFIED ? ps_group_members(codes, uint(leader.layer)) : uvec2(0u), members = whole;
#ifdef PS_LEVELS
#ifdef PS_PICTURE_CLOSEST
  bool minified = true;  // so do boxes of less than a texel
#else
  bool minified = spanned * u.footprint > 1.0;
#endif
  members = minified ? uvec2(0u) : whole;
#endif
  while ((members.x | members.y) != 0u) {
    ivec2 cell = middle + ps_next_member(members);
    int other = int(texelFetch(ps_ids, cell, 0).x & ~PS_RASTERISED) - u.first_id;
    if (ps_is_like(slot, other)) {
      PsSurfel one = s;  // what pictures do not show is constant
      v_uv = ps_member(slot, other, cell).uv;
      ps_polygon_attributes(one);
      ps_add_shown(sum, count, one);
    }
  }
#ifdef PS_LEVELS
  members = minified ? whole : uvec2(0u);
  while ((members.x | members.y) != 0u) {
    ivec2 cell = middle + ps_next_member(members);
    int other = int(texelFetch(ps_ids, cell, 0).x & ~PS_RASTERISED) - u.first_id;
    if (ps_is_like(slot, other)) {
      PsSurfel one = s;  // what pictures do not show is constant
      ps_filtered_member(one, ps_member(slot, other, cell));
      ps_add_shown(sum, count, one);
    }
  }
#endif
  if (count > 0.0) {
#ifdef PS_COLOR
    s.color = sum.color / count;
#endif
#ifdef PS_SURFACE
    s.normal.w = sum.normal.w / count;
#endif
#ifdef PS_EMISSION
    s.emission = sum.emission / count;
#endif
  }
#endif
#ifdef PS_PLACED_TANGENT
  s.tangent = texelFetch(ps_placed_tangent, leader.texel, 0);
#endif
#ifdef PS_OWNER
  s.owner = uint(about.y);
#endif
  ps_store(s);
}
