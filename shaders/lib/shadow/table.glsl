// Tables of optical depth around each light: their layout, and what a cell or the four around a direction hold in front of
// a distance. Reference: scripts/common/shadow_truth.py; layout: render/shadow/packed_tables.py.
// Samplers: ps_shadow_tables (the cells of all lights), ps_shadow_lights (one row for each light, of this view).

#ifdef PS_SHADOW_TABLES

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
  float ramp;
};

struct PsShadowEntry {
  float at;
  PsDepth total;
};

// What receives the light, in the light's coordinates.
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
                       ps_shadow_index(bases.z), ps_shadow_index(bases.w), rest.x > 0.5, rest.w);
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

// Distance at which the receiver's plane meets the middle of a cell (longitude, latitude); see plane_distance in
// core/shadow/grid.py.
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
  float ramp = width * level.ramp;
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
    if (level.kind < PS_VOLUME && p.oriented) {
      limit = ps_shadow_plane(p, vec2(column / record.w, level.low + row * level.step)) - bias;
    }
    column -= record.y;
    column -= level.wraps ? record.z * floor((column + 0.5) / record.z) : 0.0;
    if (inside && column >= 0.0 && column < record.z) {
      ivec2 range = ps_shadow_range(level, ps_shadow_index(record.x) + int(column));
      float until = level.kind == PS_OPAQUE ? tap.near_opaque - PS_SHADOW_OVERLAP_CELLS * width : tap.near;
      PsDepth found = PsDepth(0.0);
      for (int end = tap.near > 0.0 ? 2 : 1; end > 0; end--) {
        found = ps_shadow_up_to(level, range, min(end == 2 ? until : tap.far, limit), ramp) - found;
      }
      // llvmpipe ends all loops of an invocation after 65,535 turns, also these searches: light is never to be gained.
      found = max(found, PsDepth(0.0));
      result += share * (level.kind == PS_OPAQUE ? 1.0 - exp(-found) : found);
    }
  }
  return result;
}

#endif
