// Shadows of lights without size, by depth maps seen from them: layout and records in render/shadow/maps.py.
// PS_SHADOW_MAPS: some light has one. PS_SHADOW_PANES: some light has one of panes, layer behind layer (render/shadow/panes.py).
// PS_SHADOW_FACES: some light looks at faces (faces.glsl).
// PS_SHADOW_NESTED: maps of suns may hold finer ones for what is near (render/shadow/nested.py).
// PS_SHADOW_STRANDS: maps show strands, of which some texels are covered here and there: sub-samples do not tell of each other.
// PS_FOOTPRINT: the share is a mean over the sub-samples of a group, so that edges within a pixel are as smooth as its
// silhouettes.
// Samplers: ps_shadow_maps (bits of the depths of all views beyond their near planes, which grow with these), ps_map_lights (one
// row for each light, of this view), ps_shadow_panes and ps_pane_lights (the same of panes, with shares of light).

#if defined(PS_SHADOW_MAPS) || defined(PS_SHADOW_PANES) || defined(PS_SHADOW_FACES)

#define PS_MAP_PARALLEL 1.0
#define PS_MAP_CUBE 3.0
#define PS_MAP_HEAD 4
#define PS_MAP_BIAS 0.5  // texels: how far above its plane a receiver is not shaded by what it is part of
#define PS_MAP_BIAS_OF_BALLS 0.8  // the surfaces of other balls rise above that plane within a texel, where they meet
#define PS_MAP_BIAS_IN_MEDIA 1.5
#define PS_MAP_BIAS_OF_STRANDS 0.1  // what lies within a wide texel does not shade them, which fur seen from afar shows
#define PS_MAP_RISE_OF_STRANDS 0.25  // pixels: a cell, as wide as thin strands are drawn at least
#define PS_MAP_ROUNDING 2e-6  // of distances
#define PS_MAP_STEEPEST 0.1  // cosine: surfaces that light grazes more closely are treated as this one
#define PS_MAP_BACK vec2(0.1, 0.3)  // cosines, see ps_map_above
#define PS_MAP_BIAS_OF_BACKS 0.02  // of the bias

#if defined(PS_HAS_POINTS) || defined(PS_HAS_SPOTS) || defined(PS_SHADOW_NESTED)
#define PS_MAP_VIEWS  // a map may have several, or none of a point
#endif

#ifdef PS_FOOTPRINT
#define PS_MAP_SHARP 2.0
#define PS_MAP_GRAZED 0.1  // cosine, see ps_raise
#define PS_MAP_FIRST 7  // sub-samples: where so many agree, no others are looked at

// The sub-samples of the group that is shaded.
struct PsFootprint {
  ivec2 middle;  // central cell of the pixel
  uvec2 members;  // see ps_group_members
  float above;  // texels, and view units, above its plane, or a strand, up to which a receiver is not shaded by what it is part of
  float rise;
  bool keyed;  // each sub-sample lies in a plane whose normal is that of its key, turned by
  vec3 turn;  // what is added to it; else in that by which the group is shaded
  vec3 plane, bulge;  // normal of the triangle's plane, and how far the surface bulges above that, along the group's normal
  vec3 raised;  // where the sub-samples are looked at from, above themselves: see ps_raise
#ifdef PS_FOG
  bool air;  // a place in the fog is looked at instead
  vec3 place;
#endif
};
PsFootprint ps_footprint;

// A sub-sample of the group, in view space.
struct PsMember {
  vec3 position, normal;
};

// Takes one of `members`. normal: the one by which the group is shaded.
PsMember ps_member(inout uvec2 members, vec3 normal)
{
  ivec2 cell = ps_footprint.middle + ps_next_member(members);
#ifdef PS_FOG
  if (ps_footprint.air) {
    return PsMember(ps_footprint.place, vec3(0.0));
  }
#endif
  float d = uintBitsToFloat(texelFetch(ps_depths, cell, 0).x) + u.near;
  vec3 own = normal;
  if (ps_footprint.keyed) {
    own = normalize(ps_key_normal(texelFetch(ps_keys, cell, 0).x) + ps_footprint.turn);
#ifdef PS_BACKLIT
    own *= dot(own, normal) < 0.0 ? -1.0 : 1.0;
#endif
  }
  return PsMember(ps_view_from_pixel(ps_pixel_from_cell(vec2(cell) + 0.5), d) + ps_footprint.raised, own);
}

// Triangles whose normals are interpolated see light that their planes graze, or turn away from, from the surface that they stand
// for (Hanika 2021); by how much is as in Cycles. toward: the light; normal: by which it is seen.
void ps_raise(vec3 toward, vec3 normal)
{
  float by_plane = dot(ps_footprint.plane, toward), by_normal = dot(normal, toward);
  float share = clamp(1.0 + max(1.0 - max(by_normal, 0.0) / PS_MAP_GRAZED, 0.0) - by_plane / PS_MAP_GRAZED, 0.0, 1.0);
  ps_footprint.raised = dot(normal, ps_footprint.bulge) > 0.0 ? share * ps_footprint.bulge : vec3(0.0);
}
#endif

#ifdef PS_SHADOW_NESTED
#define PS_MAP_NESTED 25  // first texel about nested maps

// Which map of a sun shows the finest what is around a place in its space: 0: that of the scene, or one nested in it.
int ps_nested_map(int row, vec3 q)
{
  int map = 0;
  for (int i = 0; i < 3; i++) {
    vec4 ends = texelFetch(ps_map_lights, ivec2(PS_MAP_NESTED + 2 * i, row), 0);
    vec2 depths = texelFetch(ps_map_lights, ivec2(PS_MAP_NESTED + 2 * i + 1, row), 0).xy;
    bool holds = all(greaterThan(q, vec3(ends.xy, depths.x))) && all(lessThan(q, vec3(ends.zw, depths.y)));
    map = holds ? i + 1 : map;
  }
  return map;
}
#endif

// Its row among the records of lights, and what all its views share.
struct PsMapLight {
  int row;
  vec4 x, y, z;  // rows of the matrix from view space
  vec4 head;  // kind; of panes also the number of layers, and texels from one to the next
#ifdef PS_SHADOW_NESTED
  int nested;  // of a sun: see ps_nested_map
#endif
#ifndef PS_MAP_VIEWS
  vec4 frame, ends;  // of its only view
#endif
};

PsMapLight ps_map_light(sampler2D records, int row)
{
  PsMapLight light;
  light.row = row;
  light.head = texelFetch(records, ivec2(3, row), 0);
  light.x = texelFetch(records, ivec2(0, row), 0);
  light.y = texelFetch(records, ivec2(1, row), 0);
  light.z = texelFetch(records, ivec2(2, row), 0);
#ifdef PS_SHADOW_NESTED
  light.nested = 0;
#endif
#ifndef PS_MAP_VIEWS
  light.frame = texelFetch(records, ivec2(PS_MAP_HEAD, row), 0);
  light.ends = texelFetch(records, ivec2(PS_MAP_HEAD + 1, row), 0);
#endif
  return light;
}

// A receiver in a view: the four texels around it, and its plane there.
struct PsMapPlace {
  bool seen, parallel;
  ivec2 low;
  ivec4 ends;
  vec2 share, sharp;  // of the way to the next texel; as it weighs texels
  vec3 q, n;
  float step, facing, bias, reach, near;
};

// Share of its bias that a surface has whose plane turns away from the light. Smooth normals may see the light all the same. What
// turns away a little is part of something round, of which triangles must not shade each other; what turns away more is the back
// of something, which may be thinner than a texel, as leaves are.
float ps_map_above(float cosine)
{
  return mix(1.0, PS_MAP_BIAS_OF_BACKS, clamp((cosine - PS_MAP_BACK.x) / (PS_MAP_BACK.y - PS_MAP_BACK.x), 0.0, 1.0));
}

// normal: unit, or zero where there is no surface. above, rise: see PsFootprint.
PsMapPlace ps_map_place(PsMapLight light, sampler2D records, vec3 position, vec3 normal, float above, float rise)
{
  PsMapPlace at;
  vec4 point = vec4(position, 1.0);
  vec3 q = vec3(dot(light.x, point), dot(light.y, point), dot(light.z, point));
  vec3 n = vec3(dot(light.x.xyz, normal), dot(light.y.xyz, normal), dot(light.z.xyz, normal));
#ifdef PS_MAP_VIEWS
#ifdef PS_SHADOW_NESTED
  int view = light.nested;
#else
  int view = 0;
#endif
  if (light.head.x == PS_MAP_CUBE) {
    // The face's axis first.
    vec3 size = abs(q);
    int axis = size.x >= size.y && size.x >= size.z ? 0 : (size.y >= size.z ? 1 : 2);
    q = axis == 0 ? q : (axis == 1 ? q.yzx : q.zxy);
    n = axis == 0 ? n : (axis == 1 ? n.yzx : n.zxy);
    bool positive = q.x > 0.0;
    view = 2 * axis + (positive ? 0 : 1);
    q = positive ? q.zyx : vec3(q.yz, -q.x);
    n = positive ? n.zyx : vec3(n.yz, -n.x);
  }
  vec4 frame = texelFetch(records, ivec2(PS_MAP_HEAD + 2 * view, light.row), 0);
  at.ends = ivec4(texelFetch(records, ivec2(PS_MAP_HEAD + 2 * view + 1, light.row), 0));
  at.parallel = light.head.x == PS_MAP_PARALLEL;
#else
  vec4 frame = light.frame;
  at.ends = ivec4(light.ends);
  at.parallel = true;
#endif
  at.seen = at.ends.z >= 0 && (at.parallel || q.z > 0.0);
  vec3 ray = at.parallel ? vec3(0.0, 0.0, 1.0) : vec3(q.xy / q.z, 1.0);
  vec2 place = frame.xy + frame.z * (at.parallel ? q.xy : ray.xy) - 0.5;
  vec2 low = floor(place);
  at.low = ivec2(low);
  at.share = place - low;
  at.step = 1.0 / frame.z;
  float texel = (at.parallel ? 1.0 : q.z) * at.step;  // world units
#ifdef PS_FOOTPRINT
  // Where several texels lie in a pixel, its sub-samples make the mean.
  at.sharp = clamp((at.share - 0.5) * max(PS_MAP_SHARP * ps_pixel_size(-position.z) / texel, 1.0) + 0.5, 0.0, 1.0);
#else
  at.sharp = at.share;
#endif
  bool oriented = dot(n, n) > 0.0;
  at.facing = dot(n, ray);
  float cosine = at.facing * inversesqrt(dot(ray, ray));
  above *= ps_map_above(cosine);
  at.bias = (oriented ? (texel * above + rise) / max(abs(cosine), PS_MAP_STEEPEST) : texel * (rise > 0.0 ? PS_MAP_BIAS_OF_STRANDS : PS_MAP_BIAS_IN_MEDIA) + rise) +
            PS_MAP_ROUNDING * (abs(q.z) + length(position));
  at.reach = oriented ? texel * (1.0 / PS_MAP_STEEPEST) : 0.0;
  at.near = frame.w;
  at.q = q;
  at.n = n;
  return at;
}

// Bits of the depth up to which what a texel holds lies before the receiver: that of its plane there, so that a surface does not
// shade itself. corner: which of the four texels.
uint ps_map_limit(PsMapPlace at, vec2 corner)
{
  float rising = at.parallel ? -1.0 / (at.facing == 0.0 ? 1e-20 : at.facing) : 0.0;
  float slope = dot(at.n.xy, (corner - at.share) * at.step);
  float there = at.facing + slope;
  float plane = at.parallel ? slope * rising : (there * at.facing > 0.0 ? -at.q.z * slope / there : -at.reach);
  return floatBitsToUint(max(at.q.z + clamp(plane, -at.reach, at.reach) - at.bias - at.near, 0.0));
}

float ps_map_weight(PsMapPlace at, vec2 corner)
{
  vec2 weight = mix(1.0 - at.sharp, at.sharp, corner);
  return weight.x * weight.y;
}

ivec2 ps_map_texel(PsMapPlace at, vec2 corner)
{
  return clamp(at.low + ivec2(corner), at.ends.xy, at.ends.zw);
}

#endif

#ifdef PS_SHADOW_MAPS

// Share of the light, from 0 to 1, that reaches a point in view space, between the four texels around it.
float ps_map_lit(PsMapLight light, vec3 position, vec3 normal, float above, float rise)
{
  PsMapPlace at = ps_map_place(light, ps_map_lights, position, normal, above, rise);
  if (!at.seen) {
    return 1.0;
  }
  float lit = 0.0;
  for (int i = 0; i < 4; i++) {
    vec2 corner = vec2(i & 1, i >> 1);
    uint found = texelFetch(ps_shadow_maps, ps_map_texel(at, corner), 0).x;
    lit += found < ps_map_limit(at, corner) ? 0.0 : ps_map_weight(at, corner);
  }
  return lit;
}

// Share of the light of light `light` that no caster of its map keeps from a point in view space.
float ps_map_share(int light, vec3 position, vec3 normal, bool wanted)
{
  PsMapLight map = ps_map_light(ps_map_lights, light);
  wanted = wanted && map.head.x > 0.0;
#ifdef PS_SHADOW_NESTED
  vec4 point = vec4(position, 1.0);
  map.nested = ps_nested_map(light, vec3(dot(map.x, point), dot(map.y, point), dot(map.z, point)));
#endif
#ifdef PS_FOOTPRINT
  uvec2 members = wanted ? ps_footprint.members : uvec2(0u);
  float sum = 0.0, count = 0.0;
  while ((members.x | members.y) != 0u) {
    PsMember member = ps_member(members, normal);
    sum += ps_map_lit(map, member.position, member.normal, ps_footprint.above, ps_footprint.rise);
    count += 1.0;
#ifndef PS_SHADOW_STRANDS
    members = count == float(PS_MAP_FIRST) && (sum == 0.0 || sum > count - 1e-3) ? uvec2(0u) : members;
#endif
  }
  return count > 0.0 ? sum / count : 1.0;
#else
  float lit = 1.0;
  for (int i = 0; i < (wanted ? 1 : 0); i++) {
    lit = ps_map_lit(map, position, normal, PS_MAP_BIAS, 0.0);
  }
  return lit;
#endif
}

#endif
