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
#define PS_SOFT_ALIKE 1e-4  // shares of a light that do not matter
#define PS_SOFT_STEEPEST 0.05  // cosine: planes that a point of the light grazes more closely are treated as this one

// A view of a light, and what receives there.
struct PsSoftLight {
  bool parallel;
  mat3 turn;  // from view space to the view's, with
  vec3 offset;
  vec4 frame;
  ivec4 ends;
  float gain;  // how sharp edges between texels are
  float own;  // height of the receiver
#ifdef PS_SHADOW_NESTED
  float lift;  // at which all views show the same place
#endif
  vec2 place;  // of the receiver in the view from the light's middle
  float scale;  // of lengths there
  vec3 at, normal;  // of the receiver in the view's space
  bool oriented;
  float above, rounding;  // how far the receiver is lifted from its plane, and towards the light
};

// Sets what receives: a point in view space. normal: of its plane; (0, 0, 0) in a medium.
void ps_soft_receive(inout PsSoftLight s, vec3 position, vec3 normal)
{
  vec3 q = s.turn * position + s.offset, n = s.turn * normal;
  s.scale = s.parallel ? 1.0 : 1.0 / q.z;
  s.place = q.xy * s.scale;
  s.own = s.parallel ? -q.z : s.scale;
  s.at = q;
  s.normal = n;
  s.oriented = dot(n, n) > 0.0;
  float texel = (s.parallel ? 1.0 : q.z) / s.frame.z;  // world units
  s.above = texel * (s.oriented ? PS_MAP_BIAS : PS_MAP_BIAS_IN_MEDIA);
#ifdef PS_FOOTPRINT
  s.above += s.oriented ? ps_footprint.rise : 0.0;
#endif
  s.rounding = PS_MAP_ROUNDING * (abs(q.z) + length(position));
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

// How much of the light at a point of the light, in the view's space, comes to the receiver if nothing keeps it, in a unit of
// its own: by Lambert's law from a plane light. What is below the receiver's plane counts only where all of the light is.
float ps_soft_weight(PsSoftLight s, vec3 point)
{
  float unit = inversesqrt(max(dot(s.at, s.at), 1e-30));
  vec3 toward = s.parallel ? vec3(point.xy, -1.0) : (point - s.at) * unit;
  float square = s.parallel ? 1.0 : max(dot(toward, toward), 1e-8);
  return s.oriented ? max(dot(s.normal, toward), 1e-6) / (square * square) : 1.0;
}

// Of four texels about a place in the view of a point of the light: x: the share that lets the light through; y, z: the sum
// of the heights above the receiver of what does not, and its weight. moved: places from the receiver to the ray.
vec3 ps_soft_tap(PsSoftLight s, vec2 point, vec2 shift, ivec2 tile, vec2 moved)
{
#ifdef PS_SHADOW_NESTED
  float above = s.own - s.lift;
#else
  float above = s.own;
#endif
  vec2 place = shift + s.frame.xy + s.frame.z * (s.place - above * point + moved) - 0.5;
  vec2 low = floor(place), share = place - low;
  // How the plane's height grows in the view of the point.
  vec3 ray = vec3((s.parallel ? vec2(0.0) : s.place) - s.scale * point, 1.0);
  float along = inversesqrt(dot(ray, ray)), cosine = dot(s.normal, ray) * along;
  cosine = (cosine < 0.0 ? -1.0 : 1.0) * max(abs(cosine), PS_SOFT_STEEPEST);
  vec2 slope = s.normal.xy * s.scale * along / cosine;
  float bias = (s.oriented ? s.above / abs(cosine) : s.above) + s.rounding;
  bias *= s.parallel ? 1.0 : s.scale * s.scale;
  vec2 sharp = clamp((share - 0.5) * s.gain + 0.5, 0.0, 1.0);
  // In the order in which they are gathered.
  vec4 right = vec4(0.0, 1.0, 1.0, 0.0), up = vec4(1.0, 1.0, 0.0, 0.0);
  ivec2 first = clamp(ivec2(low), s.ends.xy, s.ends.zw - 1) + tile * (s.ends.zw - s.ends.xy + 1);
  uvec4 found = textureGather(ps_shadow_maps, (vec2(first) + 1.0) / vec2(textureSize(ps_shadow_maps, 0)));
  vec4 depth = uintBitsToFloat(min(found, uvec4(0x7F000000u))) + s.frame.w;  // nothing is far away
  vec4 height = (s.parallel ? -depth : 1.0 / depth) - s.own;
  vec2 step = slope / s.frame.z;
  vec4 plane = dot(slope, moved) + bias + step.x * (right - share.x) + step.y * (up - share.y);
  vec4 weight = mix(vec4(1.0 - sharp.x), vec4(sharp.x), right) * mix(vec4(1.0 - sharp.y), vec4(sharp.y), up);
  vec4 hidden = weight * vec4(greaterThan(height, plane));
  return vec3(1.0 - dot(hidden, vec4(1.0)), dot(hidden, height), dot(hidden, vec4(1.0)));
}

// Share of the light of light `light`, one with a size, that no caster of its maps keeps from a point in view space.
float ps_soft_share(int light, vec3 position, vec3 normal, bool wanted)
{
  vec4 head = texelFetch(ps_map_lights, ivec2(3, light), 0);
  vec4 x = texelFetch(ps_map_lights, ivec2(0, light), 0), y = texelFetch(ps_map_lights, ivec2(1, light), 0);
  vec4 z = texelFetch(ps_map_lights, ivec2(2, light), 0);
  vec4 first = texelFetch(ps_map_lights, ivec2(PS_SOFT_SHAPE, light), 0);
  vec3 second = texelFetch(ps_map_lights, ivec2(PS_SOFT_SHAPE + 1, light), 0).xyz;
  PsSoftLight s;
  s.turn = transpose(mat3(x.xyz, y.xyz, z.xyz));
  s.offset = vec3(x.w, y.w, z.w);
  vec3 half_u = first.xyz, half_v = second, q = s.turn * position + s.offset;
  int view = 0;
  if (-head.x == PS_MAP_CUBE) {
    vec3 size = abs(q);
    int axis = size.x >= size.y && size.x >= size.z ? 0 : (size.y >= size.z ? 1 : 2);
    mat3 second_first = mat3(0, 0, 1, 1, 0, 0, 0, 1, 0), third_first = mat3(0, 1, 0, 0, 0, 1, 1, 0, 0);
    mat3 turned = axis == 0 ? mat3(1.0) : (axis == 1 ? second_first : third_first);
    bool positive = (turned * q).x > 0.0;
    turned = (positive ? mat3(0, 0, 1, 0, 1, 0, 1, 0, 0) : mat3(0, 0, -1, 1, 0, 0, 0, 1, 0)) * turned;
    view = 2 * axis + (positive ? 0 : 1);
    q = turned * q;
    half_u = turned * half_u;
    half_v = turned * half_v;
    s.turn = turned * s.turn;
    s.offset = turned * s.offset;
  }
#ifdef PS_SHADOW_NESTED
  view = -head.x == PS_MAP_PARALLEL ? ps_nested_map(light, q) : view;
  s.lift = -head.x == PS_MAP_PARALLEL && view > 0
               ? texelFetch(ps_map_lights, ivec2(PS_MAP_NESTED + 2 * view - 1, light), 0).z
               : 0.0;
#endif
  s.frame = texelFetch(ps_map_lights, ivec2(PS_MAP_HEAD + 2 * view, light), 0);
  s.ends = ivec4(texelFetch(ps_map_lights, ivec2(PS_MAP_HEAD + 2 * view + 1, light), 0));
  s.parallel = -head.x == PS_MAP_PARALLEL;
  vec4 cell = texelFetch(ps_map_lights, ivec2(PS_SOFT_SHAPE + 2 + view, light), 0);
  int count = wanted && head.x < 0.0 && s.ends.z >= 0 && (s.parallel || q.z > 0.0) ? int(head.y) : 0;
  int columns = count > 16 ? 8 : 4, row = int(head.z);
  s.gain = 1.0;
#ifdef PS_FOOTPRINT
  float texel = (s.parallel ? 1.0 : q.z) / s.frame.z;  // world units
  s.gain = max(PS_MAP_SHARP * ps_pixel_size(-position.z) / texel, 1.0);
#endif
  vec2 place = q.xy * (s.parallel ? 1.0 : 1.0 / q.z);
  if (first.w > 0.5) {
    vec3 toward = normalize(vec3(place, 1.0)), across = normalize(vec3(1.0, 0.0, 0.0) - toward.x * toward);
    half_v = length(half_u) * cross(toward, across);
    half_u = length(half_u) * across;
  }
  // Where rays from the light's points meet the plane of its middle.
  vec2 u_axis = s.parallel ? half_u.xy : half_u.xy - half_u.z * place;
  vec2 v_axis = s.parallel ? half_v.xy : half_v.xy - half_v.z * place;

#ifdef PS_FOOTPRINT
  uvec2 members = uvec2(0u);
#else
  ps_soft_receive(s, position, normal);
#endif
  vec3 sum = vec3(0.0);
  float total = 0.0;
  for (int i = 0; i < count; i++) {
#ifdef PS_FOOTPRINT
    ps_soft_receive_next(s, members, normal);
#endif
    vec4 middle = texelFetch(ps_map_lights, ivec2(i * (1 + PS_POINTS_OF_CELL), row), 0);
    vec2 seen = middle.x * cell.xy + middle.y * cell.zw;
    float weight = ps_soft_weight(s, middle.x * half_u + middle.y * half_v);
    sum += weight * ps_soft_tap(s, seen, middle.zw, ivec2(i % columns, i / columns), vec2(0.0));
    total += weight;
  }
  bool mixed = min(sum.x, sum.z) > PS_SOFT_ALIKE * total;
  float lit = count > 0 ? sum.x / total : 1.0, gone = mixed ? sum.y / sum.z : 0.0;
  int turns = mixed ? count : 0;
  float soft = 0.0;
  total = 0.0;
  for (int i = 0; i < turns; i++) {
#ifdef PS_FOOTPRINT
    ps_soft_receive_next(s, members, normal);
#endif
    int column = i * (1 + PS_POINTS_OF_CELL);
    ivec2 tile = ivec2(i % columns, i / columns);
    vec4 middle = texelFetch(ps_map_lights, ivec2(column, row), 0);
    vec2 seen = middle.x * cell.xy + middle.y * cell.zw;
    // A view from below the receiver's plane shows its other side.
    float from = ps_soft_weight(s, middle.x * half_u + middle.y * half_v);
    for (int k = 1; k <= PS_POINTS_OF_CELL; k++) {
      vec2 own = texelFetch(ps_map_lights, ivec2(column + k, row), 0).xy;
      vec2 moved = gone * (own.x * u_axis + own.y * v_axis - seen);
      vec3 tap = ps_soft_tap(s, seen, middle.zw, tile, moved);
      gone = tap.z > 0.0 ? tap.y / tap.z : gone;
      float weight = from > 2e-6 ? ps_soft_weight(s, own.x * half_u + own.y * half_v) : from;
      soft += weight * tap.x;
      total += weight;
    }
  }
  return mixed ? soft / total : lit;
}

#endif
