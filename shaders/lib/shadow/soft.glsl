// Shadows of lights with a size, by depth maps seen from some of their points: layout and records in render/shadow/maps.py,
// points in render/shadow/light_points.py. PS_SHADOW_SOFT: some light has them.
//
// Heights here are what grows linearly along rays in a view's coordinates: one over the depth, or minus the depth where rays
// are parallel. A ray from `place` at the height `own` to the point c of a light is at place + c * (height - own), whatever the
// light; the view from c sees it at place - c * own. So a map tells of other points of its cell too: their rays pass it at
// a place that differs by how far they have gone at the height of what casts the shadow.
// The sub-samples of a group take turns: each view of the light is looked at from another one.

#ifdef PS_SHADOW_SOFT

#define PS_SOFT_SHAPE 16  // first texel about a light's size
#define PS_POINTS_OF_CELL 8
#define PS_SOFT_SEEN 1.2  // see BEYOND in render/shadow/map_views.py
#define PS_SOFT_CELLS 8  // that receivers look at which look at few points; and of each,
#define PS_SOFT_FEW 2  // points, where the light is hidden in part
#define PS_SOFT_ALIKE 1e-4  // shares of a light that do not matter
#define PS_SOFT_NARROW 0.25  // texels, and pixels: rims of shadows that nobody tells from sharp ones
#define PS_SOFT_SPARSE vec2(0.05, 0.45)  // shares that strands hide, see ps_soft_sparse
#define PS_SOFT_STEEPEST 0.05  // cosine: planes that a point of the light grazes more closely are treated as this one

// A light, the view of it through which the receiver is looked at, and what receives.
struct PsSoftLight {
  bool parallel, cube;
  bool flat_shape;  // flat_shape: seen from its points; else from where rays from them meet the plane of its middle
  mat3 turn;  // from view space to the light's, with
  vec3 offset;
  vec3 at, normal;  // of the receiver in the light's space
  bool oriented;
  float rounding;  // of distances
  mat3 face;  // from the light's space to the view's
  vec4 frame, cell;
  ivec4 ends;
  float seen;  // how far from its middle a view shows
#ifdef PS_SHADOW_NESTED
  float lift;  // at which all views show the same place
#endif
};

// Sets what receives: a point in view space. normal: of its plane; (0, 0, 0) in a medium.
void ps_soft_receive(inout PsSoftLight s, vec3 position, vec3 normal)
{
  s.at = s.turn * position + s.offset;
  s.normal = s.turn * normal;
  s.oriented = dot(normal, normal) > 0.0;
  s.rounding = PS_MAP_ROUNDING * (length(s.at) + length(position));
}

#ifdef PS_FOOTPRINT
// The next sub-sample of the group receives; after the last one, the first.
void ps_soft_receive_next(inout PsSoftLight s, inout uvec2 members, vec3 normal)
{
  members = (members.x | members.y) == 0u ? ps_footprint.members : members;
  PsMember member = ps_member(members, normal);
  ps_soft_receive(s, member.position, member.normal);
}
#endif

void ps_soft_look(inout PsSoftLight s, int light, int view)
{
  s.frame = texelFetch(ps_map_lights, ivec2(PS_MAP_HEAD + 2 * view, light), 0);
  s.ends = ivec4(texelFetch(ps_map_lights, ivec2(PS_MAP_HEAD + 2 * view + 1, light), 0));
  s.cell = texelFetch(ps_map_lights, ivec2(PS_SOFT_SHAPE + 2 + view, light), 0);
}

// Looks through the face of the cube about a light that something in this direction is seen through.
void ps_soft_face(inout PsSoftLight s, int light, vec3 toward)
{
  vec3 size = abs(toward);
  int axis = size.x >= size.y && size.x >= size.z ? 0 : (size.y >= size.z ? 1 : 2);
  mat3 second_first = mat3(0, 0, 1, 1, 0, 0, 0, 1, 0), third_first = mat3(0, 1, 0, 0, 0, 1, 1, 0, 0);
  mat3 turned = axis == 0 ? mat3(1.0) : (axis == 1 ? second_first : third_first);
  bool positive = (turned * toward).x > 0.0;
  s.face = (positive ? mat3(0, 0, 1, 0, 1, 0, 1, 0, 0) : mat3(0, 0, -1, 1, 0, 0, 0, 1, 0)) * turned;
  ps_soft_look(s, light, 2 * axis + (positive ? 0 : 1));
}

// How much of the light at a point of the light, in its space, comes to the receiver if nothing keeps it, in a unit of its
// own: by Lambert's law from a plane light. What is below the receiver's plane counts only where all of the light is.
float ps_soft_weight(PsSoftLight s, vec3 point)
{
  float unit = inversesqrt(max(dot(s.at, s.at), 1e-30));
  vec3 toward = s.parallel ? vec3(point.xy, -1.0) : (point - s.at) * unit;
  float square = s.parallel ? 1.0 : max(dot(toward, toward), 1e-8);
  return s.oriented ? max(dot(s.normal, toward), 1e-6) / (square * square) : 1.0;
}

// Of light `light`, what comes from its point `point` along this ray over what comes along others.
float ps_soft_emitted(PsSoftLight s, int light, vec3 point)
{
#ifdef PS_UNEVEN_LIGHTS
  return s.parallel ? 1.0 : ps_emitted(light, (s.at - point) * s.turn);
#else
  return 1.0;
#endif
}

// The receiver as the view from a point of the light sees it.
struct PsSoftSight {
  bool shown;
  float scale;  // of lengths
  float own;  // height
  vec2 place;
  float gain;  // how sharp edges between texels are
  vec2 slope;  // of the receiver's plane
  float bias;
};

// point: of the light, in the view's space. pixel: how large a pixel is there, world units.
PsSoftSight ps_soft_sight(PsSoftLight s, vec3 point, float pixel)
{
  vec3 p = s.face * s.at - (s.parallel ? vec3(0.0) : point), normal = s.face * s.normal;
  PsSoftSight sight;
  sight.scale = s.parallel ? 1.0 : 1.0 / max(p.z, 1e-30);
  sight.own = s.parallel ? -p.z : sight.scale;
#ifdef PS_SHADOW_NESTED
  float above = sight.own - s.lift;
#else
  float above = sight.own;
#endif
  sight.place = p.xy * sight.scale - (s.parallel ? above * point.xy : vec2(0.0));
  sight.shown = p.z > 0.0 && max(abs(sight.place.x), abs(sight.place.y)) < s.seen;
  // How the plane's height grows.
  vec3 ray = vec3(s.parallel ? -point.xy : sight.place, 1.0);
  float along = inversesqrt(dot(ray, ray)), cosine = dot(normal, ray) * along;
  cosine = (cosine < 0.0 ? -1.0 : 1.0) * max(abs(cosine), PS_SOFT_STEEPEST);
  sight.slope = normal.xy * sight.scale * along / cosine;
  float texel = 1.0 / (sight.scale * s.frame.z);  // world units
  float lifted = texel * (s.oriented ? PS_MAP_BIAS * ps_map_above(cosine) : PS_MAP_BIAS_IN_MEDIA);
  sight.gain = 1.0;
#ifdef PS_FOOTPRINT
  lifted = s.oriented || ps_footprint.rise == 0.0 ? lifted : texel * PS_MAP_BIAS_OF_STRANDS;
  lifted += ps_footprint.rise;
  sight.gain = max(PS_MAP_SHARP * pixel / texel, 1.0);
#endif
  sight.bias = ((s.oriented ? lifted / abs(cosine) : lifted) + s.rounding) * sight.scale * sight.scale;
  return sight;
}

// Of four texels about a place in the view of a point of the light: x: the share that lets the light through; y, z: the sum
// of the heights above the receiver of what does not, and its weight; w: the greatest of them. moved: places from the
// receiver to the ray.
vec4 ps_soft_tap(PsSoftLight s, PsSoftSight sight, vec2 shift, ivec2 tile, vec2 moved)
{
  vec2 place = shift + s.frame.xy + s.frame.z * (sight.place + moved) - 0.5;
  vec2 low = floor(place), share = place - low;
  vec2 sharp = clamp((share - 0.5) * sight.gain + 0.5, 0.0, 1.0);
  // In the order in which they are gathered.
  vec4 right = vec4(0.0, 1.0, 1.0, 0.0), up = vec4(1.0, 1.0, 0.0, 0.0);
  ivec2 first = clamp(ivec2(low), s.ends.xy, s.ends.zw - 1) + tile * (s.ends.zw - s.ends.xy + 1);
  uvec4 found = textureGather(ps_shadow_maps, (vec2(first) + 1.0) / vec2(textureSize(ps_shadow_maps, 0)));
  vec4 depth = uintBitsToFloat(min(found, uvec4(0x7F000000u))) + s.frame.w;  // nothing is far away
  vec4 height = (s.parallel ? -depth : 1.0 / depth) - sight.own;
  vec2 step = sight.slope / s.frame.z;
  vec4 plane = dot(sight.slope, moved) + sight.bias + step.x * (right - share.x) + step.y * (up - share.y);
  vec4 weight = mix(vec4(1.0 - sharp.x), vec4(sharp.x), right) * mix(vec4(1.0 - sharp.y), vec4(sharp.y), up);
  vec4 hidden = s.ends.z < 0 ? vec4(0.0) : weight * vec4(greaterThan(height, plane));
  vec4 above = mix(vec4(0.0), height, greaterThan(hidden, vec4(0.0)));
  float greatest = max(max(above.x, above.y), max(above.z, above.w));
  return vec4(1.0 - dot(hidden, vec4(1.0)), dot(hidden, height), dot(hidden, vec4(1.0)), greatest);
}

// How a cell's view sees the receiver, which is turned to that view where each has a face of its own. middle: of the cell, on
// the half-axes of the light. from: where the view is, in its space; weight: what comes from there, 0 where it is not shown.
PsSoftSight ps_soft_cell(inout PsSoftLight s, int light, vec2 middle, vec3 half_u, vec3 half_v, float pixel, out vec3 from,
                         out float weight)
{
  vec3 there = middle.x * half_u + middle.y * half_v;
  if (s.cube && s.flat_shape) {
    ps_soft_face(s, light, s.at - there);
  }
  from = s.flat_shape ? s.face * there : vec3(middle.x * s.cell.xy + middle.y * s.cell.zw, 0.0);
  PsSoftSight sight = ps_soft_sight(s, from, pixel);
  weight = sight.shown ? ps_soft_weight(s, there) : 0.0;
  return sight;
}

#ifdef PS_SHADOW_STRANDS
// How much the first look, at one place of each cell, counts where it finds this share of the light hidden. Of sparse strands
// it may find none: to look closer only where it found some would count them too little. Elsewhere strands play no part.
float ps_soft_sparse(PsSoftLight s, int light, vec3 q, float reach, float hidden)
{
  vec4 ball = texelFetch(ps_map_lights, ivec2(PS_SOFT_SHAPE + 8, light), 0);
  // Where the ray to the light's middle passes the ball the closest, and how far apart rays from all of the light are there.
  float away = s.parallel ? 1.0 : length(q);
  vec3 ray = s.parallel ? vec3(0.0, 0.0, -1.0) : -q / max(away, 1e-30);
  float along = clamp(dot(ball.xyz - q, ray), 0.0, s.parallel ? 1e30 : away);
  float wide = reach * min((along + ball.w) / away, s.parallel ? 1e30 : 1.0);
  bool passes = distance(ball.xyz, q + along * ray) < ball.w + wide;
  return passes ? 1.0 - smoothstep(PS_SOFT_SPARSE.x, PS_SOFT_SPARSE.y, hidden) : 0.0;
}
#endif

// Share of the light of light `light`, one with a size, that no caster of its maps keeps from a point in view space.
float ps_soft_share(int light, vec3 position, vec3 normal, bool wanted)
{
  vec4 head = texelFetch(ps_map_lights, ivec2(3, light), 0);
  vec4 x = texelFetch(ps_map_lights, ivec2(0, light), 0), y = texelFetch(ps_map_lights, ivec2(1, light), 0);
  vec4 z = texelFetch(ps_map_lights, ivec2(2, light), 0);
  vec4 first = texelFetch(ps_map_lights, ivec2(PS_SOFT_SHAPE, light), 0);
  vec3 half_u = first.xyz, half_v = texelFetch(ps_map_lights, ivec2(PS_SOFT_SHAPE + 1, light), 0).xyz;
  PsSoftLight s;
#if defined(PS_HAS_SUNS) && defined(PS_ONE_KIND)
  s.cube = false;
  s.parallel = true;
#else
  s.cube = -head.x == PS_MAP_CUBE;
  s.parallel = -head.x == PS_MAP_PARALLEL;
#endif
  s.flat_shape = !s.parallel && first.w < 0.5;
  s.turn = transpose(mat3(x.xyz, y.xyz, z.xyz));
  s.offset = vec3(x.w, y.w, z.w);
  s.face = mat3(1.0);
  s.seen = s.cube ? PS_SOFT_SEEN : 1e30;
  vec3 q = s.turn * position + s.offset;
  int view = 0;
#ifdef PS_SHADOW_NESTED
  view = s.parallel ? ps_nested_map(light, q) : view;
  s.lift = s.parallel && view > 0 ? texelFetch(ps_map_lights, ivec2(PS_MAP_NESTED + 2 * view - 1, light), 0).z : 0.0;
#endif
  if (s.cube) {
    ps_soft_face(s, light, q);
  }
  else {
    ps_soft_look(s, light, view);
  }
  if (first.w > 0.5) {
    vec3 toward = s.face * normalize(q), across = normalize(vec3(1.0, 0.0, 0.0) - toward.x * toward);
    half_v = length(half_u) * cross(toward, across) * s.face;
    half_u = length(half_u) * across * s.face;
  }
  int count = wanted && head.x < 0.0 ? int(head.y) : 0;
  int columns = count > 16 ? 8 : 4, row = int(head.z), cells = max(count, 1);
#ifdef PS_SHADOW_SPREAD
  // Cells are in an order in which some that follow each other are spread over all of the light.
  bool few = ps_spread.points < count;
  int start = few ? int(ps_point_sequence(ps_spread.number, PS_POINT_X) * float(cells)) : 0;
  int at_cell = int(ps_point_sequence(ps_spread.number, PS_POINT_Y) * float(PS_POINTS_OF_CELL));
  count = few ? min(PS_SOFT_CELLS, count) : count;
#endif
#ifdef PS_FOOTPRINT
  float pixel = ps_pixel_size(-position.z);
  uvec2 members = uvec2(0u);
#else
  float pixel = 0.0;
  ps_soft_receive(s, position, normal);
#endif
  vec3 sum = vec3(0.0);
  float total = 0.0, greatest = 0.0, texels = 0.0;  // that a pixel is wide
  for (int i = 0; i < count; i++) {
#ifdef PS_FOOTPRINT
    ps_soft_receive_next(s, members, normal);
#endif
#ifdef PS_SHADOW_SPREAD
    int cell = (start + i) % cells;
#else
    int cell = i;
#endif
    vec4 middle = texelFetch(ps_map_lights, ivec2(cell * (1 + PS_POINTS_OF_CELL), row), 0);
    vec3 from;
    float weight;
    PsSoftSight sight = ps_soft_cell(s, light, middle.xy, half_u, half_v, pixel, from, weight);
    weight *= ps_soft_emitted(s, light, middle.x * half_u + middle.y * half_v);
    vec4 tap = ps_soft_tap(s, sight, middle.zw, ivec2(cell % columns, cell / columns), vec2(0.0));
    sum += weight * tap.xyz;
    greatest = max(greatest, tap.w);
    texels = pixel * sight.scale * s.frame.z;
    total += weight;
  }
  bool mixed = min(sum.x, sum.z) > PS_SOFT_ALIKE * total;
  float lit = total > 0.0 ? sum.x / total : 1.0, gone = mixed ? sum.y / sum.z : 0.0;
#ifdef PS_FOOTPRINT
  // Where rays from all of a cell pass the same texels, and land in the same pixel, its view has told of all of them, and only
  // sub-samples that were not looked at tell more.
  float rim = greatest * max(length(half_u), length(half_v)) * s.frame.z;
  bool narrow = rim < PS_SOFT_NARROW * min(texels, 1.0);
  bool known = narrow && bitCount(ps_footprint.members.x) + bitCount(ps_footprint.members.y) <= count;
#else
  const bool narrow = false, known = false;
#endif
  int turns = mixed && !known ? count : 0;
  float soft = 0.0;
  total = 0.0;
  for (int i = 0; i < turns; i++) {
#ifdef PS_FOOTPRINT
    ps_soft_receive_next(s, members, normal);
#endif
#ifdef PS_SHADOW_SPREAD
    int cell = (start + i) % cells, points = narrow ? 1 : few ? PS_SOFT_FEW : PS_POINTS_OF_CELL;
#else
    int cell = i, points = narrow ? 1 : PS_POINTS_OF_CELL;
#endif
    int column = cell * (1 + PS_POINTS_OF_CELL);
    ivec2 tile = ivec2(cell % columns, cell / columns);
    vec4 middle = texelFetch(ps_map_lights, ivec2(column, row), 0);
    vec3 from;
    float least;  // a view from below the receiver's plane shows its other side
    PsSoftSight sight = ps_soft_cell(s, light, middle.xy, half_u, half_v, pixel, from, least);
    for (int j = 1; j <= points; j++) {
#ifdef PS_SHADOW_SPREAD
      int k = few ? 1 + (at_cell + 3 * i + 5 * j) % PS_POINTS_OF_CELL : j;
#else
      int k = j;
#endif
      vec2 own = texelFetch(ps_map_lights, ivec2(column + k, row), 0).xy;
      vec3 point = own.x * half_u + own.y * half_v, apart = s.face * point - from;
      vec2 moved = gone * (apart.xy - (s.parallel ? vec2(0.0) : apart.z * sight.place));
      vec4 tap = ps_soft_tap(s, sight, middle.zw, tile, moved);
      gone = tap.z > 0.0 ? tap.y / tap.z : gone;
      float weight = (least > 2e-6 ? ps_soft_weight(s, point) : least) * ps_soft_emitted(s, light, point);
      soft += weight * tap.x;
      total += weight;
    }
  }
#ifdef PS_SHADOW_STRANDS
  float reach = 1.5 * max(length(half_u), length(half_v));
  lit = mixed ? mix(total > 0.0 ? soft / total : lit, lit, ps_soft_sparse(s, light, q, reach, 1.0 - lit)) : lit;
  return lit;
#else
  return mixed && total > 0.0 ? soft / total : lit;
#endif
}

#endif
