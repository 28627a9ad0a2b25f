// How much of a light's light reaches a point. Reference: scripts/common/shadow_truth.py; layout: render/shadow/packed_tables.py.
// PS_SHADOWS: some light casts shadows; else nothing here exists. PS_SHADOW_MAPS: some by a depth map (map.glsl);
// PS_SHADOW_PANES: some by layers of panes (panes.glsl); PS_SHADOW_FACES: some by faces of these (faces.glsl);
// PS_SHADOW_TABLES: some by a table, and of these: PS_SHADOW_COLORED: optical depths have three channels.
// Shadows of wide lights are the mean of PS_SHADOW_TAPS points of the light, of a sequence that goes on from sample to
// sample of a picture: PS_SHADOW_SAMPLE is the sample's number. PS_SHADOW_ONE_CELL: samples are so many that each looks
// at one cell instead of interpolating four. PS_SHADOW_SOLID: only opaque things cast.
// PS_SHADOW_FIRST: where so many points of the light agree, no others are looked at.
// PS_RELIT: receivers lie in the tables themselves, as captured splats, and look at them from ps_lift above.
// PS_SHADOW_SUNS: all lights are suns. PS_SHADOW_HARD: none has a size. PS_SHADOW_SPREAD: see points.glsl.

#include "lib/shadow/points.glsl"
#include "lib/shadow/table.glsl"
#include "lib/shadow/map.glsl"
#include "lib/shadow/soft.glsl"
#include "lib/shadow/panes.glsl"
#include "lib/shadow/faces.glsl"

#ifdef PS_SHADOW_TABLES

#define PS_SHADOW_ALIKE 0.004  // differences of transmittance that an 8-bit picture does not show

PsReceiver ps_shadow_receiver(bool parallel, vec3 local, vec3 normal)
{
  float across = length(local.xy);
  PsReceiver p;
  p.parallel = parallel;
  p.oriented = dot(normal, normal) > 0.0;
  p.normal = normal;
  // atan(0, 0) is undefined.
  p.latitude = parallel ? local.y : atan(local.z, max(across, 1e-30));
  p.longitude = parallel ? local.x : atan(local.y, across > 0.0 ? local.x : 1.0);
  p.at = parallel ? local.z : length(local);
  p.ray = parallel ? vec3(0.0, 0.0, 1.0) : ps_shadow_ray(p.latitude, p.longitude);
  p.east = parallel ? vec3(1.0, 0.0, 0.0) : vec3(-sin(p.longitude), cos(p.longitude), 0.0);
  p.north = cross(p.ray, p.east);
  return p;
}

// Distance from the light at which rays to its points have departed so far.
float ps_shadow_along(PsReceiver p, float spread)
{
  return p.parallel ? p.at - spread : p.at / (1.0 + p.at * spread);
}

// The first level from `i` on that holds something between the tap's distances. Few do, and software rasterisers run
// the body of a loop only as often as some pixel needs it.
int ps_shadow_next(int light, int i, int levels, PsReceiver p, PsTap tap)
{
  bool holds = false;
  while (i < levels && !holds) {
    int column = PS_SHADOW_HEAD + 3 * i;
    float cell = texelFetch(ps_shadow_lights, ivec2(column, light), 0).y * (p.parallel ? 1.0 : p.at);
    vec3 ends = texelFetch(ps_shadow_lights, ivec2(column + 2, light), 0).yzw;
    float width = cell * max(ends.z, 1.0);
    float near = tap.near > 0.0 ? min(tap.near, tap.near_opaque - PS_SHADOW_OVERLAP_CELLS * cell) : -1e30;
    holds = tap.far > ends.x - width && near < ends.y + width;
    i += holds ? 0 : 1;
  }
  return i;
}

// How far the ray from the light's rim departs from the ray from its middle, per size of the light, at a distance.
float ps_shadow_spread(PsReceiver p, float nearest, float radius)
{
  return max(p.parallel ? p.at - nearest : 1.0 / max(max(nearest, radius), 1e-30) - 1.0 / max(p.at, 1e-30), 0.0);
}

// The same, where the first entry lies that rays from all of the light to the receiver may meet; see Receiver.spread_at_nearest.
// `nearest`: of all entries.
float ps_shadow_reach(int light, PsReceiver p, float nearest, float radius)
{
  vec4 squares = texelFetch(ps_shadow_lights, ivec2(6, light), 0);
  vec4 begin = texelFetch(ps_shadow_lights, ivec2(7, light), 0);
  float narrowed = p.parallel ? PS_SHADOW_LOOSE : max(cos(p.latitude) - 1.0 + PS_SHADOW_LOOSE, 1e-3);
  float scale = radius * PS_SHADOW_CORNER / (narrowed * squares.z), spread = ps_shadow_spread(p, nearest, radius);
  vec2 finest = (vec2(p.latitude, p.longitude) - squares.xy) / squares.z;
  for (int k = 0; k < PS_SHADOW_NARROWINGS; k++) {
    float size = min(ceil(log2(max(spread * scale, 1.0))), squares.w), count = begin.x * exp2(-size);
    vec2 place = clamp(floor(finest * exp2(-size)), vec2(0.0), vec2(count - 1.0));
    // Squares of the sizes before: count^2 of the finest, a quarter of the next.
    int before = int((begin.x * begin.x - count * count) * (4.0 / 3.0) + 0.5);
    int i = ps_shadow_index(begin.y) + before + int(place.x * count + place.y);
    spread = ps_shadow_spread(p, ps_shadow_texel(i >> 2)[i & 3], radius);
  }
  return spread;
}

// Share of the light of light `light` (a row of ps_shadow_lights) that what casts into tables lets through to a point.
vec3 ps_table_transmittance(int light, vec3 position, vec3 normal, bool wanted)
{
  vec4 x = texelFetch(ps_shadow_lights, ivec2(0, light), 0), y = texelFetch(ps_shadow_lights, ivec2(1, light), 0);
  vec4 z = texelFetch(ps_shadow_lights, ivec2(2, light), 0), head = texelFetch(ps_shadow_lights, ivec2(3, light), 0);
  vec4 size_u = texelFetch(ps_shadow_lights, ivec2(4, light), 0);
  vec4 size_v = texelFetch(ps_shadow_lights, ivec2(5, light), 0);
  vec4 point = vec4(position, 1.0);
  vec3 local = vec3(dot(x, point), dot(y, point), dot(z, point));
  vec3 local_normal = vec3(dot(x.xyz, normal), dot(y.xyz, normal), dot(z.xyz, normal));
#ifdef PS_SHADOW_SUNS
  const bool parallel = true;
#else
  bool parallel = head.x == 1.0;
#endif
  PsReceiver p = ps_shadow_receiver(parallel, local, local_normal);
  int levels = int(head.y), shape = int(head.z);

  float radius = size_u.w;
#ifdef PS_SHADOW_HARD
  const float spread = 0.0;
  const bool wide = false;
#else
  float spread = radius > 0.0 ? ps_shadow_reach(light, p, head.w, radius) : 0.0;
  bool wide = spread * radius > PS_SHADOW_SHARP * size_v.w;
#endif
  bool narrow = spread * radius <= PS_SHADOW_NARROW * size_v.w;
#ifdef PS_SHADOW_SPREAD
  int every = min(ps_spread.points, PS_SHADOW_TAPS);
  uint first = ps_spread.number * uint(every) + uint(PS_SHADOW_SAMPLE) * PS_POINT_SAMPLES;
#else
  const int every = PS_SHADOW_TAPS;
  uint first = uint(PS_SHADOW_SAMPLE * PS_SHADOW_TAPS);
#endif
  int taps = !wanted ? 0 : wide ? every : 1;
  int segments = !wide ? 1 : narrow ? PS_SHADOW_FEW_SEGMENTS : PS_SHADOW_SEGMENTS;

  vec3 sum = vec3(0.0);
#ifdef PS_SHADOW_FIRST
  vec3 least = vec3(1e30), most = vec3(-1e30);
#endif
  for (int k = 0; k < taps; k++) {
    uint index = first + uint(k);
    vec2 light_point = vec2(ps_point_sequence(index, PS_POINT_X), ps_point_sequence(index, PS_POINT_Y));
    light_point = shape == PS_RECTANGLE ? 2.0 * light_point - 1.0
                                 : sqrt(light_point.x) * vec2(cos(6.28318531 * light_point.y), sin(6.28318531 * light_point.y));
    float cut = ps_point_sequence(index, PS_POINT_CUT);
    vec3 offset = shape == PS_DISK && !p.parallel ? radius * (light_point.x * p.east + light_point.y * p.north)
                                                  : light_point.x * size_u.xyz + light_point.y * size_v.xyz;
    offset = wide ? offset - dot(offset, p.ray) * p.ray : vec3(0.0);
    PsTap tap;
#ifdef PS_SHADOW_ONE_CELL
    tap.one = true;
#else
    tap.one = wide;
#endif
    tap.jitter = vec2(ps_point_sequence(index, PS_POINT_ROW), ps_point_sequence(index, PS_POINT_COLUMN)) - 0.5;

    float left = 1.0;
    PsDepth depth = PsDepth(0.0);
    // Behind what is covered there is no light.
    for (int j = 0; j < segments && left > 0.0; j++) {
      float covered = 0.0;
      // Square roots of parts of the spread.
      float start = wide ? (float(j) + cut - 1.0) / float(segments - 1) : 0.0;
      float end = start + 1.0 / float(max(segments - 1, 1));
      float middle = wide ? max(0.5 * (start + end), 0.0) : 0.0;
      float behind = end + PS_SHADOW_OVERLAP * (end - start);
      middle *= middle * spread;
      start = max(start, 0.0);
      tap.far = ps_shadow_along(p, start * start * spread);
      tap.near = end >= 1.0 || !wide ? 0.0 : ps_shadow_along(p, end * end * spread);
      tap.near_opaque = ps_shadow_along(p, behind * behind * spread);
      vec3 direction = p.ray + offset * middle;
      tap.latitude = p.parallel || !wide ? p.latitude + offset.y * middle
                                        : atan(direction.z, max(length(direction.xy), 1e-30));
      tap.longitude = p.parallel || !wide ? p.longitude + offset.x * middle : atan(direction.y, direction.x);
      int i = ps_shadow_next(light, 0, levels, p, tap);
      for (; i < levels; i = ps_shadow_next(light, i + 1, levels, p, tap)) {
        PsShadowLevel level = ps_shadow_level(light, i);
        PsDepth found = ps_shadow_look_up(level, p, tap);
#ifdef PS_SHADOW_COLORED
        covered += level.kind == PS_OPAQUE ? found.x : 0.0;
#else
        covered += level.kind == PS_OPAQUE ? found : 0.0;
#endif
        depth += level.kind == PS_OPAQUE ? PsDepth(0.0) : found;
      }
      left *= max(1.0 - covered, 0.0);
    }
    vec3 through = vec3(left * exp(-depth));
    sum += through;
#ifdef PS_SHADOW_FIRST
    least = min(least, through);
    most = max(most, through);
    if (k == PS_SHADOW_FIRST - 1 && all(lessThan(most - least, vec3(PS_SHADOW_ALIKE)))) {
      taps = PS_SHADOW_FIRST;
    }
#endif
  }
  return sum / float(max(taps, 1));
}

#endif

#ifdef PS_RELIT
vec3 ps_lift;
#endif

#ifdef PS_SHADOWS

// Share of the light of light `light` that reaches a point in view space. `normal`: unit, of the surface there, or zero where
// there is none. Surfaces that face away from the light do not want to know.
vec3 ps_transmittance(int light, vec3 position, vec3 normal, bool wanted)
{
  vec3 share = vec3(1.0);
#ifdef PS_SHADOW_MAPS
  share *= ps_map_share(light, position, normal, wanted);
  wanted = wanted && share.x > 0.0;
#endif
#ifdef PS_SHADOW_SOFT
  share *= ps_soft_share(light, position, normal, wanted);
  wanted = wanted && share.x > 0.0;
#endif
#ifdef PS_SHADOW_PANES
  share *= ps_pane_share(light, position, normal, wanted);
#endif
#ifdef PS_SHADOW_FACES
  share *= ps_face_share(light, position, normal, wanted);
#endif
#ifdef PS_SHADOW_TABLES
#ifdef PS_RELIT
  position += ps_lift;
#endif
  share *= ps_table_transmittance(light, position, normal, wanted);
#endif
  return share;
}

#endif
