// How much of a lamp's light reaches a point, from its table. Reference and layout: core/shadow.py.
// Samplers: ps_shadow_tables (all lamps' cells), ps_shadow_lights (one row for each lamp, of this view).
// PS_SHADOW_COLORED: optical depths have three channels.

#define PS_SHADOW_BIAS 1.0
#define PS_SHADOW_UNORIENTED_BIAS 1.5
#define PS_SHADOW_STEEPEST 0.1
#define PS_SHADOW_REACH 8.0
#define PS_SHADOW_HEAD 4
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
  vec3 ray, normal;
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

// What a cell holds in front of a distance; see _up_to.
PsDepth ps_shadow_up_to(PsShadowLevel level, int cell, float limit, float ramp)
{
  ivec2 range = ps_shadow_range(level, cell);
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
  if (level.kind == PS_OPAQUE) {
    return min(total, PsDepth(1.0));
  }
  PsShadowEntry next = ps_shadow_entry(has_next ? low : range.x), previous = ps_shadow_entry(max(low - 2, range.x));
  float before = limit - last.at, after = next.at - limit;
  float reach = max(has_last && has_next ? min(ramp, 0.5 * (before + after)) : ramp, 1e-30);
  float missing = has_last ? 0.5 * clamp(1.0 - before / reach, 0.0, 1.0) : 0.0;
  float added = has_next ? 0.5 * clamp(1.0 - after / reach, 0.0, 1.0) : 0.0;
  PsDepth own = total - (low - 2 >= range.x ? previous.total : PsDepth(0.0));
  PsDepth others = has_next ? next.total - total : PsDepth(0.0);
  return total - missing * own + added * others;
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

// Distance at which the receiver's plane meets the middle of a cell; see _plane_distance.
float ps_shadow_plane(PsReceiver p, vec2 cell, float cell_size)
{
  float facing = dot(p.normal, p.ray), rise, limit = PS_SHADOW_REACH * cell_size;
  if (p.parallel) {
    rise = -dot(p.normal.xy, cell.yx - vec2(p.longitude, p.latitude)) / ps_shadow_cosine(facing);
  }
  else {
    float there = dot(p.normal, ps_shadow_ray(cell.x, cell.y));
    rise = p.at * (ps_shadow_cosine(facing) / ps_shadow_cosine((there > 0.0) == (facing > 0.0) ? there : facing) - 1.0);
    limit *= p.at;
  }
  return p.at + clamp(rise, -limit, limit);
}

// What a level holds in front of the receiver, between the four cells around it.
PsDepth ps_shadow_look_up(PsShadowLevel level, PsReceiver p)
{
  float width = level.step * (p.parallel ? 1.0 : p.at);
  float place = (p.latitude - level.low) / level.step;
  float bias = width * PS_SHADOW_BIAS / max(abs(dot(p.normal, p.ray)), PS_SHADOW_STEEPEST);
  PsDepth result = PsDepth(0.0);
  for (int i = 0; i < 4; i++) {
    float row = floor(place) + float(i >> 1);
    float row_share = 1.0 - abs(place - row);
    bool inside = row >= 0.0 && row < level.rows;
    vec4 record = ps_shadow_texel(level.row_base + int(clamp(row, 0.0, level.rows - 1.0)));
    float across = p.longitude * record.w;
    float column = floor(across) + float(i & 1);
    float share = row_share * (1.0 - abs(across - column));
    float limit = p.at;
    if (level.kind != PS_VOLUME && p.oriented) {
      limit = ps_shadow_plane(p, vec2(level.low + row * level.step, column / record.w), level.step) - bias;
    }
    else if (level.kind == PS_OPAQUE) {
      limit = p.at - PS_SHADOW_UNORIENTED_BIAS * width;
    }
    column -= record.y;
    column -= level.wraps ? record.z * floor((column + 0.5) / record.z) : 0.0;
    if (inside && share > 0.0 && column >= 0.0 && column < record.z) {
      result += share * ps_shadow_up_to(level, ps_shadow_index(record.x) + int(column), limit, 0.5 * width);
    }
  }
  return result;
}

// Share of the light of lamp `light` (a row of ps_shadow_lights) that reaches a point in view space. `normal`: unit, of
// the surface there, or zero where there is none.
vec3 ps_transmittance(int light, vec3 position, vec3 normal)
{
  vec4 x = texelFetch(ps_shadow_lights, ivec2(0, light), 0), y = texelFetch(ps_shadow_lights, ivec2(1, light), 0);
  vec4 z = texelFetch(ps_shadow_lights, ivec2(2, light), 0), head = texelFetch(ps_shadow_lights, ivec2(3, light), 0);
  vec4 point = vec4(position, 1.0);
  vec3 local = vec3(dot(x, point), dot(y, point), dot(z, point));
  PsReceiver p;
  p.parallel = head.x == 1.0;
  p.normal = vec3(dot(x.xyz, normal), dot(y.xyz, normal), dot(z.xyz, normal));
  p.oriented = dot(normal, normal) > 0.0;
  float across = length(local.xy);
  // atan(0, 0) is undefined.
  p.latitude = p.parallel ? local.y : atan(local.z, max(across, 1e-30));
  p.longitude = p.parallel ? local.x : atan(local.y, across > 0.0 ? local.x : 1.0);
  p.at = p.parallel ? local.z : length(local);
  p.ray = p.parallel ? vec3(0.0, 0.0, 1.0) : ps_shadow_ray(p.latitude, p.longitude);

  float covered = 0.0;
  PsDepth depth = PsDepth(0.0);
  int levels = int(head.y);
  for (int i = 0; i < levels; i++) {
    PsShadowLevel level = ps_shadow_level(light, i);
    PsDepth found = ps_shadow_look_up(level, p);
    if (level.kind == PS_OPAQUE) {
#ifdef PS_SHADOW_COLORED
      covered += found.x;
#else
      covered += found;
#endif
    }
    else {
      depth += found;
    }
  }
  return vec3(max(1.0 - covered, 0.0) * exp(-depth));
}
