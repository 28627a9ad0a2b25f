// Gathers what a receiver sees of the light tree, and of the sky behind it, without a random number (Christensen 2008;
// Ritschel et al. 2009). One texel a receiver; its layout: render/passes/indirect/gather.py.
//   out_diffuse: irradiance / pi; mean over the hemisphere, by cosine, of one over the distance, the sky's 0
//   out_glossy: mean radiance of surfaces over the lobe around the mirrored view, and the share of the lobe that is open
// A walk meets near nodes first. A node is opened until it is smaller than a cell; then it covers as much of the cells under it
// as it is large: what surfaces cover adds up, so that they are tight; leaves and hairs hide each other as if they lay there by
// chance. PS_GLOSSY: out_glossy is wanted.

#include "lib/light/environment.glsl"
#include "lib/indirect/tree.glsl"
#include "lib/indirect/hemisphere.glsl"

#define PS_STACK 128
#define PS_MOST_NODES 20000  // that a walk opens: software rasterisers end all loops together after 65,535 turns
#define PS_FINENESS (0.375 * float(PS_CELLS))  // parts of a near leaf along its side, for each step of t
#define PS_MOST_PARTS (PS_CELLS * 3 / 2)
#define PS_LEAST_HEIGHT 0.003  // sides of a leaf, above which a receiver is at least
#define PS_LEAST_OF_ROUGH 0.25  // the same, where the leaf only stands for surfaces near it
// Squares of pieces tile cells unevenly: above the first share of a cell, what is open is closed faster, so many times.
#define PS_GAPS 0.9
#define PS_TIGHTENED 3.0
// How large nodes may be whose surfaces are turned to all sides, over those that are flat: one mean radiance stands for all.
#define PS_TURNED 0.25
#define PS_ABOVE 0.05  // radii of a leaf above the receiver's plane from which on it is seen
#define PS_OUTSIDE 2.0  // fronts over backs that a receiver has seen, from which on it lies outside of things
#define PS_HIDES 2.0  // of backs, over what is shown of fronts, that are hidden there
#define PS_BESIDE 1.2  // times farther away than backs, up to which fronts take their place
#define PS_SKY_ROUGHNESS 0.4  // of the world's picture that is as blurred as a cell is wide

float ps_covered[PS_CELLS * PS_CELLS];  // share of the cell
float ps_weight[PS_CELLS * PS_CELLS];  // of what covers it: solid angle times cosine
vec3 ps_light[PS_CELLS * PS_CELLS];  // that comes from what covers it, times solid angle and cosine
float ps_fronts = 0.0, ps_backs = 0.0;  // solid angles of surfaces that were seen from before, and from behind
float ps_left[PS_CELLS * PS_CELLS];  // one over the distance of what is seen from behind, the latest
float ps_inside[PS_CELLS * PS_CELLS];  // covered by surfaces that are seen from before, less those from behind

// Puts the child whose octant differs from `own` by `k` on the stack.
#define PS_PUSH(k) \
  if ((node.bits >> (own ^ k) & 1) != 0) { \
    stack[size] = node.first + bitCount(node.bits & ((1 << (own ^ k)) - 1)); \
    size++; \
  }

struct PsGathered {
  vec3 diffuse;
  float nearness;
  vec3 glossy;
};

// Weight of a direction in the lobe around the mirrored view, both with z along the normal.
float ps_lobe(vec3 direction, vec4 lobe)
{
  return exp(lobe.w * (dot(direction, lobe.xyz) - 1.0));
}

void ps_add_glossy(inout PsGathered sum, vec3 radiance, float solid_angle, vec3 direction, vec4 lobe)
{
#ifdef PS_GLOSSY
  sum.glossy += radiance * (solid_angle * ps_lobe(direction, lobe));
#endif
}

// A piece of surface as a receiver sees it.
struct PsSeen {
  vec3 direction;  // unit
  vec3 radiance;  // of what faces the receiver
  float nearness;  // one over its distance
  float front, back;  // solid angles of what faces the receiver, and of what does not
};

// Covers a part, a rectangle of a cell, by a piece of surface; `share`: of the piece that lies in it, per area in cells.
void ps_cover(inout PsGathered sum, ivec2 at, vec2 low, vec2 high, float share, float cell, PsSeen seen, PsNodeLook look, vec4 lobe)
{
  vec2 overlap = min(high, vec2(at + 1)) - max(low, vec2(at));
  if (overlap.x <= 0.0 || overlap.y <= 0.0 || at.x >= PS_CELLS || at.y >= PS_CELLS) {
    return;
  }
  float part = overlap.x * overlap.y * share / cell;
  int i = at.y * PS_CELLS + at.x;
  // Of surfaces that a cell shows from behind, as much is hidden as it shows from before: where they are closed, by themselves.
  // Receivers that see mostly fronts lie outside of things: as their cells show fronts and backs unevenly, more is hidden there.
  // A walk does not meet all in order: fronts that come hardly farther away take the place of such backs before them.
  float entered = seen.front * part, left = seen.back * part;
  float shown = look.scattered ? 0.0 : (1.0 - ps_covered[i]) * cell;
  ps_fronts += entered * shown;
  ps_backs += left * shown;
  float late = 0.0;
  if (!look.scattered && ps_inside[i] < 0.0 && seen.nearness * PS_BESIDE > ps_left[i]) {
    late = min(min(entered, -ps_inside[i]), ps_covered[i]);
    float kept = 1.0 - late / max(ps_covered[i], 1e-30);
    ps_covered[i] -= late;
    ps_weight[i] *= kept;
    ps_light[i] *= kept;
    ps_inside[i] += late;
  }
  float hides = entered * (ps_fronts >= PS_OUTSIDE * ps_backs ? PS_HIDES : 1.0) - late;
  float hidden = look.scattered ? 0.0 : min(left, max(ps_inside[i], 0.0) + hides);
  float seen_back = left - hidden, whole = entered + seen_back;
  ps_inside[i] += look.scattered ? 0.0 : hides - left;
  ps_left[i] = seen_back > 0.0 && !look.scattered ? seen.nearness : ps_left[i];
  float open = 1.0 - ps_covered[i], covers = look.scattered ? (1.0 - exp(-whole)) * open : min(whole, open);
  ps_covered[i] += covers;
  float weight = covers * cell * seen.direction.z;
  ps_weight[i] += weight;
  sum.nearness += weight * seen.nearness;
  vec3 radiance = (entered * seen.radiance + seen_back * (look.scattered ? seen.radiance : look.inside)) / max(whole, 1e-30);
  ps_light[i] += radiance * weight;
  ps_add_glossy(sum, radiance, covers * cell, seen.direction, lobe);
}

// A piece is smaller than a cell, and counts as a square of a cell's size around it: cells are then covered more evenly than by
// squares of its own size.
void ps_deposit(inout PsGathered sum, PsSeen seen, PsNodeLook look, vec4 lobe)
{
  float cell = ps_cell_solid_angle(seen.direction);
  vec2 centre = ps_cell_from_direction(seen.direction);
  vec2 low = clamp(centre - 0.5, vec2(0.0), vec2(PS_CELLS)), high = clamp(centre + 0.5, vec2(0.0), vec2(PS_CELLS));
  vec2 sides = max(high - low, 1e-6);
  float share = 1.0 / (sides.x * sides.y);
  ivec2 first = ivec2(low);
  // Without a loop, whose turns would count.
  ps_cover(sum, first, low, high, share, cell, seen, look, lobe);
  ps_cover(sum, first + ivec2(1, 0), low, high, share, cell, seen, look, lobe);
  ps_cover(sum, first + ivec2(0, 1), low, high, share, cell, seen, look, lobe);
  ps_cover(sum, first + ivec2(1, 1), low, high, share, cell, seen, look, lobe);
}

// How much larger than a cell a node may be whose surface is flat than one that is turned to all sides.
float ps_sameness(PsNode node)
{
  float along = float(node.bits >> 9 & 63) / 63.0;
  return mix(PS_TURNED, 1.0, along * along * along);
}

void main()
{
  ivec2 texel = ivec2(gl_FragCoord.xy);
  ivec2 at = ivec2(3 * texel.x, texel.y);
  vec4 place = texelFetch(ps_receivers, at, 0), up = texelFetch(ps_receivers, at + ivec2(1, 0), 0);
  vec4 mirror = texelFetch(ps_receivers, at + ivec2(2, 0), 0);
  if (dot(up.xyz, up.xyz) == 0.0) {
    discard;
  }
  vec3 n = up.xyz;
  // Duff et al. 2017.
  float side = n.z >= 0.0 ? 1.0 : -1.0, a = -1.0 / (side + n.z), b = n.x * n.y * a;
  vec3 tangent = vec3(1.0 + side * n.x * n.x * a, side * b, -side * n.x);
  vec3 across = vec3(b, side + n.y * n.y * a, -n.y);
  vec4 lobe = vec4(dot(mirror.xyz, tangent), dot(mirror.xyz, across), dot(mirror.xyz, n), place.w);

  for (int i = 0; i < PS_CELLS * PS_CELLS; i++) {
    ps_covered[i] = 0.0;
    ps_weight[i] = 0.0;
    ps_light[i] = vec3(0.0);
    ps_inside[i] = 0.0;
    ps_left[i] = 0.0;
  }
  PsGathered sum = PsGathered(vec3(0.0), 0.0, vec3(0.0));
  int stack[PS_STACK];
  stack[0] = u.root;
  int size = 1, opened = 0;
  while (size > 0) {
    size--;
    int number = stack[size];
    PsNode node = ps_node(number);
    vec3 offset = node.position - place.xyz;
    float height = dot(offset, n);
    if (height + node.radius <= 0.0) {
      continue;
    }
    float d2 = max(dot(offset, offset), 1e-36), d = sqrt(d2);
    vec3 local = vec3(dot(offset, tangent), dot(offset, across), max(height, 0.0)) / d;
    float cell = ps_cell_solid_angle(local);
    float largest = min(PS_PI * node.radius * node.radius, 2.0 * node.area) / d2;
    opened++;
    if (node.first >= 0 && opened < PS_MOST_NODES && (d < 1.5 * node.radius || largest > u.coarseness * cell * ps_sameness(node)) && size < PS_STACK - 8) {
      // Where the receiver lies, seen from the node; the children there come first, those opposite last.
      int own = (offset.x < 0.0 ? 1 : 0) | (offset.y < 0.0 ? 2 : 0) | (offset.z < 0.0 ? 4 : 0);
      PS_PUSH(7) PS_PUSH(6) PS_PUSH(5) PS_PUSH(4) PS_PUSH(3) PS_PUSH(2) PS_PUSH(1) PS_PUSH(0)
      continue;
    }
    PsNodeLook look = ps_node_look(number, node);
    // How high it rises above its middle: as far as it is tilted.
    float upright = look.along * dot(look.axis, n);
    float tilt = node.radius * sqrt(clamp(1.0 - upright * upright, 0.0, 1.0));
    if (height + tilt <= PS_ABOVE * node.radius) {
      continue;
    }
    // A leaf that is near is a rectangle, of which parts are looked at, the smaller the nearer they are: x = h sinh(t) has
    // steps of t that look alike from a height h above 0.
    ivec2 parts = ivec2(1);
    vec3 along = vec3(0.0), beside = vec3(0.0);
    vec2 foot = vec2(0.0), heights = vec2(1.0), from = vec2(0.0), until = vec2(0.0);
    vec2 half_sides = vec2(0.0);
    vec3 middle = offset;
    bool triangle = false;
    float side_length = sqrt(node.area);
    if (node.first < 0 && look.along > 0.5) {
      vec3 f = look.axis;
      vec3 first = normalize(abs(f.z) < 0.7 ? vec3(f.y, -f.x, 0.0) : vec3(0.0, f.z, -f.y));
      PsLeafEdge edge = ps_leaf_edge(node);
      along = edge.turn.x * first + edge.turn.y * cross(f, first);
      beside = cross(f, along);
      triangle = edge.half_of_it;
      half_sides = (triangle ? 0.70710678 : 0.5) * side_length * vec2(edge.ratio, 1.0 / edge.ratio);
      // The middle of a triangle is a third of a half side away from that of its rectangle.
      middle += triangle ? (half_sides.x * along + half_sides.y * beside) / 3.0 : vec3(0.0);
      foot = -vec2(dot(middle, along), dot(middle, beside));
      vec2 off = max(abs(foot) - half_sides, 0.0);
      float least = node.first == -1 ? PS_LEAST_OF_ROUGH : PS_LEAST_HEIGHT;
      float above_it = max(abs(dot(f, offset)), least * side_length);
      heights = sqrt(above_it * above_it + off.yx * off.yx);
      from = asinh((-half_sides - foot) / heights);
      until = asinh((half_sides - foot) / heights);
      parts = ivec2(clamp(ceil(PS_FINENESS * (until - from)), 1.0, float(PS_MOST_PARTS)));
    }
    for (int part = 0; part < parts.x * parts.y; part++) {
      vec2 number = vec2(part % parts.x, part / parts.x);
      vec2 low = heights * sinh(mix(from, until, number / vec2(parts)));
      vec2 high = heights * sinh(mix(from, until, (number + 1.0) / vec2(parts)));
      bool whole_leaf = parts.x * parts.y == 1;
      vec2 where = foot + 0.5 * (low + high), sides = high - low;
      float area = whole_leaf ? node.area : sides.x * sides.y;
      if (triangle && !whole_leaf) {
        // What of the part lies within the triangle.
        float begins = dot((foot + low) / half_sides + 1.0, vec2(0.5)), ends = dot((foot + high) / half_sides + 1.0, vec2(0.5));
        float within = clamp((1.0 - begins) / (ends - begins), 0.0, 1.0);
        area *= within < 0.5 ? 2.0 * within * within : 1.0 - 2.0 * (1.0 - within) * (1.0 - within);
      }
      vec3 to = whole_leaf ? offset : middle + where.x * along + where.y * beside;
      float rises = dot(to, n), of_part = whole_leaf ? tilt : tilt * max(sides.x, sides.y) / side_length;
      float top = rises + of_part;
      if (top <= 0.0) {
        continue;
      }
      float above = smoothstep(0.0, max(2.0 * of_part, 1e-30), top);
      float away2 = max(dot(to, to), 1e-36), away = sqrt(away2);
      float signed_area = -dot(look.facing, to) / away, toward = -dot(look.axis, to) / away;
      float both = max(look.along * abs(toward) + 0.5 * (1.0 - look.along), abs(signed_area));
      float angle = 0.5 * above * area / (away2 + area / (2.0 * PS_PI));
      PsSeen seen;
      seen.nearness = 1.0 / away;
      seen.front = (both + signed_area) * angle;
      seen.back = (both - signed_area) * angle;
      seen.direction = normalize(vec3(dot(to, tangent), dot(to, across), max(rises, 0.25 * top)));
      seen.radiance = toward > 0.0 ? look.before : look.behind;
      ps_deposit(sum, seen, look, lobe);
    }
  }

  float whole = 0.0, whole_lobe = 0.0, open_lobe = 0.0;
  for (int y = 0; y < PS_CELLS; y++) {
    for (int x = 0; x < PS_CELLS; x++) {
      float weight = 0.0, angle = 0.0;
      for (int k = 0; k < 4; k++) {
        vec3 part = ps_direction_from_cell(vec2(x, y) + vec2(k & 1, k >> 1) * 0.5 + 0.25);
        float of_part = 0.25 * ps_cell_solid_angle(part);
        angle += of_part;
        weight += of_part * part.z;
      }
      vec3 direction = ps_direction_from_cell(vec2(x, y) + 0.5);
      int i = y * PS_CELLS + x;
      float covered = ps_covered[i], tight = min(covered + max(covered - PS_GAPS, 0.0) * PS_TIGHTENED, 1.0);
      float left = 1.0 - tight, scale = tight / max(covered, 1e-6);
      sum.diffuse += ps_light[i] * scale;
      // What is open of a cell that is covered in part is where it is not: on the other side of its middle.
      float left_weight = left > 1e-3 ? clamp(weight - ps_weight[i] * scale, 0.0, weight) : 0.0;
      whole += weight;
#ifdef PS_GLOSSY
      float of_lobe = angle * ps_lobe(direction, lobe);
      whole_lobe += of_lobe;
      open_lobe += left * of_lobe;
#endif
      vec3 sky = vec3(0.0);
#if defined(PS_HAS_WORLD)
      sky = texelFetch(ps_lights, ivec2(0, PS_WORLD_ROW), 0).rgb;
#elif defined(PS_HAS_ENVIRONMENT)
      for (int k = 0; k < (left > 0.0 ? 1 : 0); k++) {
        vec3 world = direction.x * tangent + direction.y * across + direction.z * n;
        sky = ps_environment_radiance(ps_image_from_view(world), PS_SKY_ROUGHNESS);
      }
#endif
      sum.diffuse += sky * left_weight;
    }
  }
#ifdef PS_GLOSSY
  out_glossy = vec4(sum.glossy, open_lobe) / max(whole_lobe, 1e-30);
#endif
  out_diffuse = vec4(sum.diffuse, sum.nearness) / whole;
}
