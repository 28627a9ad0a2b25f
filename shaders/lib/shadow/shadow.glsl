// How much of a lamp's light reaches a point. Reference: tests/reference/shadow.py; layout: render/shadow/pages.py.
// Samplers: ps_shadow_tables (all lamps' cells), ps_shadow_lights (one row for each lamp, of this view).
// PS_SHADOWS: some lamp casts shadows; else nothing here exists. PS_SHADOW_COLORED: optical depths have three channels.
// Shadows of wide lamps are the mean of PS_SHADOW_TAPS points of the lamp, of a sequence that goes on from sample to
// sample of a picture: PS_SHADOW_SAMPLE is the sample's number. PS_SHADOW_ONE_CELL: samples are so many that each looks
// at one cell instead of interpolating four. PS_SHADOW_SOLID: only opaque things cast.
// PS_SHADOW_SUNS: all lamps are suns. PS_SHADOW_HARD: none has a size.

#ifdef PS_SHADOWS

#ifndef PS_SHADOW_TAPS
#define PS_SHADOW_TAPS 4
#endif
#ifndef PS_SHADOW_SAMPLE
#define PS_SHADOW_SAMPLE 0
#endif

#define PS_SHADOW_BIAS 1.0
#define PS_SHADOW_UNORIENTED_BIAS 1.5
#define PS_SHADOW_STEEPEST 0.1
#define PS_SHADOW_SHARP 0.5
#define PS_SHADOW_SEGMENTS 4
#define PS_SHADOW_FEW_SEGMENTS 2
#define PS_SHADOW_NARROW 2.0
#define PS_SHADOW_OVERLAP 0.3
#define PS_SHADOW_OVERLAP_CELLS 1.0
#define PS_SHADOW_CORNER 1.42
#define PS_SHADOW_LOOSE 0.65
#define PS_SHADOW_NARROWINGS 2
#define PS_SHADOW_HEAD 8
#define PS_DISK 1
#define PS_RECTANGLE 2
#define PS_OPAQUE 0.0
#define PS_VOLUME 2.0

#ifdef PS_SHADOW_COLORED
#define PsDepth vec3
#else
#define PsDepth float
#endif

struct PsShadowLevel {
  float low, step, rows, kind;
  int row_base, mask_base, link_base, entry_base;
  bool wraps;
};

struct PsShadowEntry {
  float at;
  PsDepth total;
};

// What receives the light, in the lamp's coordinates.
struct PsReceiver {
  bool parallel, oriented;
  float latitude, longitude, at;
  vec3 ray, north, east, normal;
};

// Where a table is looked up: the direction, and between which distances. `jitter` in cells, if only one cell is.
struct PsTap {
  float latitude, longitude, far, near, near_opaque;
  bool one;
  vec2 jitter;
};

vec4 ps_shadow_texel(int i)
{
  return texelFetch(ps_shadow_tables, ivec2(i & 4095, i >> 12), 0);
}

// Integers are kept as the bits of positive normal numbers, which every device copies unchanged.
int ps_shadow_index(float code)
{
  return floatBitsToInt(code) - 0x00800000;
}

ivec2 ps_shadow_links(int i)
{
  vec4 texel = ps_shadow_texel(i >> 2), next = ps_shadow_texel((i + 1) >> 2);
  return ivec2(ps_shadow_index(texel[i & 3]), ps_shadow_index(next[(i + 1) & 3]));
}

PsShadowEntry ps_shadow_entry(int i)
{
#ifdef PS_SHADOW_COLORED
  vec4 texel = ps_shadow_texel(i);
  return PsShadowEntry(texel.x, texel.yzw);
#else
  vec4 texel = ps_shadow_texel(i >> 1);
  return (i & 1) == 0 ? PsShadowEntry(texel.x, texel.y) : PsShadowEntry(texel.z, texel.w);
#endif
}

PsShadowLevel ps_shadow_level(int light, int level)
{
  int column = PS_SHADOW_HEAD + 3 * level;
  vec4 grid = texelFetch(ps_shadow_lights, ivec2(column, light), 0);
  vec4 bases = texelFetch(ps_shadow_lights, ivec2(column + 1, light), 0);
  vec4 rest = texelFetch(ps_shadow_lights, ivec2(column + 2, light), 0);
  return PsShadowLevel(grid.x, grid.y, grid.z, grid.w, ps_shadow_index(bases.x), ps_shadow_index(bases.y),
                       ps_shadow_index(bases.z), ps_shadow_index(bases.w), rest.x > 0.5);
}

// First entry of a cell and one past the last; the same where it holds none.
ivec2 ps_shadow_range(PsShadowLevel level, int cell)
{
  vec4 texel = ps_shadow_texel(level.mask_base + cell / 72);
  int bit = cell % 72, word = bit / 24;
  bit -= 24 * word;
  ivec3 masks = ivec3(texel.yzw);
  int rank = ps_shadow_index(texel.x) + bitCount(masks[word] & ((1 << bit) - 1));
  rank += (word > 0 ? bitCount(masks.x) : 0) + (word > 1 ? bitCount(masks.y) : 0);
  bool held = ((masks[word] >> bit) & 1) == 1;
  return held ? level.entry_base + ps_shadow_links(level.link_base + rank) : ivec2(level.entry_base);
}

// What a cell's entries hold in front of a distance; see _depth_before.
PsDepth ps_shadow_up_to(PsShadowLevel level, ivec2 range, float limit, float ramp)
{
  int low = range.x, high = range.y;
  while (low < high) {
    int middle = (low + high) >> 1;
    bool before = ps_shadow_entry(middle).at < limit;
    low = before ? middle + 1 : low;
    high = before ? high : middle;
  }
  PsShadowEntry last = ps_shadow_entry(max(low - 1, range.x));
  bool has_last = low > range.x, has_next = low < range.y;
  PsDepth total = has_last ? last.total : PsDepth(0.0);
#ifdef PS_SHADOW_SOLID
  return total;
#else
  if (level.kind == PS_OPAQUE) {
    return total;
  }
  PsShadowEntry next = ps_shadow_entry(has_next ? low : range.x), previous = ps_shadow_entry(max(low - 2, range.x));
  float before = limit - last.at, after = next.at - limit;
  float reach = max(has_last && has_next ? min(ramp, 0.5 * (before + after)) : ramp, 1e-30);
  float missing = has_last ? 0.5 * clamp(1.0 - before / reach, 0.0, 1.0) : 0.0;
  float added = has_next ? 0.5 * clamp(1.0 - after / reach, 0.0, 1.0) : 0.0;
  PsDepth own = total - (low - 2 >= range.x ? previous.total : PsDepth(0.0));
  PsDepth others = has_next ? next.total - total : PsDepth(0.0);
  return total - missing * own + added * others;
#endif
}

vec3 ps_shadow_ray(float latitude, float longitude)
{
  return vec3(cos(latitude) * vec2(cos(longitude), sin(longitude)), sin(latitude));
}

// With its sign, and not nearer to 0 than the least cosine.
float ps_shadow_cosine(float cosine)
{
  return (cosine < 0.0 ? -1.0 : 1.0) * max(abs(cosine), PS_SHADOW_STEEPEST);
}

// Distance at which the receiver's plane meets the middle of a cell (longitude, latitude); see plane_distance in core/shadow/grid.py.
float ps_shadow_plane(PsReceiver p, vec2 cell)
{
  float facing = dot(p.normal, p.ray), there = dot(p.normal, ps_shadow_ray(cell.y, cell.x));
  there = (there > 0.0) == (facing > 0.0) ? there : facing;
  float lateral = dot(p.normal.xy, cell - vec2(p.longitude, p.latitude));
  return p.parallel ? p.at - lateral / ps_shadow_cosine(facing)
                    : p.at * (ps_shadow_cosine(facing) / ps_shadow_cosine(there));
}

// What a level holds at a tap, between the four cells around it or in the one there; see _look_up.
PsDepth ps_shadow_look_up(PsShadowLevel level, PsReceiver p, PsTap tap)
{
  float width = level.step * (p.parallel ? 1.0 : p.at);
  float place = (tap.latitude - level.low) / level.step;
  float bias = width * PS_SHADOW_BIAS / max(abs(dot(p.normal, p.ray)), PS_SHADOW_STEEPEST);
  PsDepth result = PsDepth(0.0);
  int corners = tap.one ? 1 : 4;
  for (int i = 0; i < corners; i++) {
    float row = tap.one ? floor(place + tap.jitter.x + 0.5) : floor(place) + float(i >> 1);
    bool inside = row >= 0.0 && row < level.rows;
    vec4 record = ps_shadow_texel(level.row_base + int(clamp(row, 0.0, level.rows - 1.0)));
    float across = tap.longitude * record.w;
    float column = tap.one ? floor(across + tap.jitter.y + 0.5) : floor(across) + float(i & 1);
    float share = tap.one ? 1.0 : (1.0 - abs(place - row)) * (1.0 - abs(across - column));
    float limit = level.kind == PS_OPAQUE ? p.at - PS_SHADOW_UNORIENTED_BIAS * width : 1e30;
    if (level.kind != PS_VOLUME && p.oriented) {
      limit = ps_shadow_plane(p, vec2(column / record.w, level.low + row * level.step)) - bias;
    }
    column -= record.y;
    column -= level.wraps ? record.z * floor((column + 0.5) / record.z) : 0.0;
    if (inside && column >= 0.0 && column < record.z) {
      ivec2 range = ps_shadow_range(level, ps_shadow_index(record.x) + int(column));
      float until = level.kind == PS_OPAQUE ? tap.near_opaque - PS_SHADOW_OVERLAP_CELLS * width : tap.near;
      PsDepth found = PsDepth(0.0);
      for (int end = tap.near > 0.0 ? 2 : 1; end > 0; end--) {
        found = ps_shadow_up_to(level, range, min(end == 2 ? until : tap.far, limit), 0.5 * width) - found;
      }
      result += share * (level.kind == PS_OPAQUE ? 1.0 - exp(-found) : found);
    }
  }
  return result;
}

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

// Distance from the lamp at which rays to its points have departed so far.
float ps_shadow_along(PsReceiver p, float spread)
{
  return p.parallel ? p.at - spread : p.at / (1.0 + p.at * spread);
}

// A number of the additive recurrence; its terms for successive integers fill the unit interval evenly.
float ps_shadow_sequence(int index, float step)
{
  return fract(0.5 + float(index) * step);
}

// The first level from `i` on that holds something between the tap's distances. Few do, and software rasterisers run
// the body of a loop only as often as some pixel needs it.
int ps_shadow_next(int light, int i, int levels, PsReceiver p, PsTap tap)
{
  bool holds = false;
  while (i < levels && !holds) {
    int column = PS_SHADOW_HEAD + 3 * i;
    float width = texelFetch(ps_shadow_lights, ivec2(column, light), 0).y * (p.parallel ? 1.0 : p.at);
    vec2 ends = texelFetch(ps_shadow_lights, ivec2(column + 2, light), 0).yz;
    float near = tap.near > 0.0 ? min(tap.near, tap.near_opaque - PS_SHADOW_OVERLAP_CELLS * width) : -1e30;
    holds = tap.far > ends.x - width && near < ends.y + width;
    i += holds ? 0 : 1;
  }
  return i;
}

// How far the ray from the lamp's rim departs from the ray from its middle, per size of the lamp, at a distance.
float ps_shadow_spread(PsReceiver p, float nearest, float radius)
{
  return max(p.parallel ? p.at - nearest : 1.0 / max(max(nearest, radius), 1e-30) - 1.0 / max(p.at, 1e-30), 0.0);
}

// The same, where the first entry lies that rays from all of the lamp to the receiver may meet; see Receiver.spread_at_nearest.
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

// Share of the light of lamp `light` (a row of ps_shadow_lights) that reaches a point in view space. `normal`: unit, of
// the surface there, or zero where there is none. Surfaces that face away from the lamp do not want to know.
vec3 ps_transmittance(int light, vec3 position, vec3 normal, bool wanted)
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
  int taps = !wanted ? 0 : wide ? PS_SHADOW_TAPS : 1;
  int segments = !wide ? 1 : narrow ? PS_SHADOW_FEW_SEGMENTS : PS_SHADOW_SEGMENTS;

  vec3 sum = vec3(0.0);
  for (int k = 0; k < taps; k++) {
    int index = PS_SHADOW_SAMPLE * PS_SHADOW_TAPS + k;
    vec2 lamp = vec2(ps_shadow_sequence(index, 0.8812714616335696), ps_shadow_sequence(index, 0.7766393890897682));
    lamp = shape == PS_RECTANGLE ? 2.0 * lamp - 1.0
                                 : sqrt(lamp.x) * vec2(cos(6.28318531 * lamp.y), sin(6.28318531 * lamp.y));
    float cut = ps_shadow_sequence(index, 0.5315553977157914);
    vec3 offset = shape == PS_DISK && !p.parallel ? radius * (lamp.x * p.east + lamp.y * p.north)
                                                  : lamp.x * size_u.xyz + lamp.y * size_v.xyz;
    offset = wide ? offset - dot(offset, p.ray) * p.ray : vec3(0.0);
    PsTap tap;
#ifdef PS_SHADOW_ONE_CELL
    tap.one = true;
#else
    tap.one = wide;
#endif
    tap.jitter = vec2(ps_shadow_sequence(index, 0.6844301295853426), ps_shadow_sequence(index, 0.6031687406857283));
    tap.jitter -= 0.5;

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
    sum += vec3(left * exp(-depth));
  }
  return sum / float(max(taps, 1));
}

#endif
