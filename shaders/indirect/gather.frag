// Gathers what a receiver sees of the light tree, and of the sky behind it, without a random number (Christensen 2008;
// Ritschel et al. 2009). One texel a receiver; its layout: render/passes/indirect/gather.py.
//   out_diffuse: irradiance / pi; mean over the hemisphere, by cosine, of one over the distance, the sky's 0; with PS_BOUNCES instead
//     the mean of what the sky has in it
//   out_glossy: mean radiance of surfaces over the lobe around the mirrored view, and the share of the lobe that is open
// A walk meets near nodes first. A node is opened until it is smaller than a cell; then it covers as much of the cells under it
// as it is large. Nodes behind cells that are covered are passed over. What surfaces cover adds up, so that they are tight; leaves
// and hairs hide each other as if they lay there by chance, those that are bodies by their fronts alone. PS_GLOSSY: out_glossy is wanted. PS_MEDIA: media hide and send light, too, along PS_RAYS x PS_RAYS rays through each cell.
// PS_CAPTURED: there are captured splats. They cover 4 x 4 parts of each cell, for they lie in many layers, which would all add up in a
// cell that they cover in part. In a part what lies at one distance adds up, as it tiles a surface; what lies clearly farther away,
// beside how far a tilted surface goes on within a cell, is hidden by chance.
// PS_SHINING: some surfaces emit light. Small bright things, as letters are, hide others of their kind, which would add up: in a cell
// light that comes from clearly behind one of them is hidden as if by chance, in each of its quarters.
// PS_BODIES: there are fine triangles. What lies behind a body of such is hidden by it as if by chance, in cells that it covers in part,
// where it would add up else.
// PS_EVERY_SIDE: of a hemisphere, half of what a receiver within a medium sees: without the cosine.
// PS_OCCLUSION: how much of a white world is open: what hides it sends no light, and does so within a distance alone.
// PS_MOMENTS, with it: in place of out_diffuse, moments over the hemisphere of what is seen, as of core/indirect/moments.py.

#include "lib/light/environment.glsl"
#include "lib/indirect/tree.glsl"
#include "lib/indirect/hemisphere.glsl"
#ifdef PS_MEDIA
#include "lib/indirect/media.glsl"
#endif

#ifdef PS_EVERY_SIDE
#define PS_COSINE(direction) 1.0
#else
#define PS_COSINE(direction) (direction).z
#endif

#define PS_TURNS 4
#define PS_CORNERS 1.87  // how far a corner of half a square is from its middle, over the radius of a disk as large
#define PS_LEVEL_BITS 31  // of the radius of a node: how many times the cube is halved to its cell
#define PS_STACK 24  // more than the tree has levels
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
#define PS_ROUGH 2.0  // the same of what only stands for fine triangles near it, which is no corner of walls
#define PS_LEAVES 4.0  // the same of leaves, which need not be tight
#define PS_HAIRS 4.0  // and of hairs, of whose area half as much is seen
#define PS_SPREAD 1.0  // radii of these: the side of the square over which one is spread
#define PS_ROUND 2.0  // the same of balls, each of which has one radiance
#define PS_ABOVE 0.05  // radii of a leaf above the receiver's plane from which on it is seen
#define PS_LOW 0.005  // sine of the height above the horizon, below which nothing is seen
#define PS_OUTSIDE 2.0  // fronts over backs that a receiver has seen, from which on it lies outside of things
#define PS_HIDES 2.0  // of backs, over what is shown of fronts, that are hidden there
#define PS_BESIDE 1.2  // times farther away than backs, up to which fronts take their place
#define PS_FULL 0.95  // share from which on nothing more is seen in a cell: what is open of it counts as closed
#define PS_WIDENED 1.4  // how far circles reach in cells at most, over what their solid angle tells
#define PS_LAYER 0.5  // half a cell: how much farther away a surface is at its other end, over the tangent of its tilt
#define PS_LEAST_TILT 0.05  // cosine
#define PS_FLATTEST 0.02  // cosine between a surface and the way to it, from which on planes lie farther away than that tells
#define PS_SPLATS 1.0  // how large nodes of captured splats may be, over a cell
// Of the world's picture a cell shows so many parts each way, in the level that is about as blurred as these are wide: blurred as
// much as a cell is wide, it would bring what lies below the horizon above it.
#define PS_SKY_PARTS 2

float ps_covered[PS_CELLS * PS_CELLS];  // share of the cell
float ps_weight[PS_CELLS * PS_CELLS];  // of what covers it: solid angle times cosine
#ifndef PS_OCCLUSION
vec3 ps_light[PS_CELLS * PS_CELLS];  // that comes from what covers it, times solid angle and cosine
#endif
#ifdef PS_MEDIA
float ps_distance[PS_CELLS * PS_CELLS];  // of what covers it, times ps_weight
#ifdef PS_GLOSSY
vec3 ps_mirrored[PS_CELLS * PS_CELLS];  // what PsGathered has of it, before media hide some
#endif
#endif
float ps_fronts = 0.0, ps_backs = 0.0;  // solid angles of surfaces that were seen from before, and from behind
float ps_left[PS_CELLS * PS_CELLS];  // one over the distance of what is seen from behind, the latest
float ps_inside[PS_CELLS * PS_CELLS];  // covered by surfaces that are seen from before, less those from behind
uvec2 ps_full = uvec2(0u);  // cells that are covered, a bit each, 8 for a row, 4 rows in each number

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

void ps_add_glossy(inout PsGathered sum, int cell, vec3 radiance, float solid_angle, vec3 direction, vec4 lobe)
{
#if defined(PS_GLOSSY) && defined(PS_MEDIA)
  ps_mirrored[cell] += radiance * (solid_angle * ps_lobe(direction, lobe));
#elif defined(PS_GLOSSY)
  sum.glossy += radiance * (solid_angle * ps_lobe(direction, lobe));
#endif
}

// A piece of surface as a receiver sees it.
struct PsSeen {
  vec3 direction;  // unit
  vec3 radiance;  // of what faces the receiver
  float nearness;  // one over its distance
  float across;  // sides of the square that it is spread over, over its distance; at least a cell and at most two count
  float front, back;  // solid angles of what faces the receiver, and of what does not
  bool single;  // one piece of a leaf or hair that is a body, which does not hide itself
#ifdef PS_SHINING
  bool shining;  // it emits light
#endif
#ifdef PS_BODIES
  bool fine;  // it only stands for fine triangles near it
  float open;  // share that no body hides that lies before it
#endif
#if defined(PS_SHINING) || defined(PS_BODIES)
  vec3 plane;  // its normal over the distance of its plane, in the receiver's axes
#endif
#ifdef PS_CAPTURED
  float layer;  // of captured splats: how many times farther away others of the same surface may be
  vec3 normal;  // of these, in the receiver's axes
  float upright;  // and how much of a disk they show
#endif
};

#ifdef PS_SHINING
#include "lib/indirect/shining_layers.glsl"
#endif

// How much of a cell is closed of which a share is covered.
float ps_tight(float covered)
{
  return min(covered + max(covered - PS_GAPS, 0.0) * PS_TIGHTENED, 1.0);
}

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
  // Arrays are read and written once: software rasterisers do it one receiver after the other.
  float covered = ps_covered[i], inside = ps_inside[i], of_cell = ps_weight[i], latest = ps_left[i];
#ifndef PS_OCCLUSION
  vec3 light = ps_light[i];
#endif
  float entered = seen.front * part, left = seen.back * part;
  bool tiles = !look.scattered;
  float solid = tiles ? 1.0 : 0.0, shown = solid * (1.0 - covered) * cell;
  // Nodes that hold both sheets of a wall show as much of either: their fronts come first.
  ps_fronts += entered * shown;
  ps_backs += max(left - entered, 0.0) * shown;
  bool is_late = tiles && inside < 0.0 && seen.nearness * PS_BESIDE > latest;
  float late = is_late ? min(min(entered, -inside), covered) : 0.0;
  float kept = 1.0 - late / max(covered, 1e-30);
  covered -= late;
  inside += late;
  float hides = entered * (ps_fronts >= PS_OUTSIDE * ps_backs ? PS_HIDES : 1.0) - late;
  float hidden = look.solid ? left : solid * min(left, max(inside, 0.0) + hides);
  float seen_back = left - hidden, whole = entered + seen_back;
  inside += solid * (hides - left);
  float open = 1.0 - covered, by_chance = seen.single ? min(whole, 1.0) : 1.0 - exp(-whole);
#ifdef PS_BODIES
  float shows = whole * seen.open;
#else
  float shows = whole;
#endif
  float covers = look.scattered ? by_chance * open : min(shows, open);
  covered += covers;
#ifdef PS_SHINING
  covers = ps_cover_quarters(i, max(low - vec2(at), 0.0), min(high - vec2(at), 1.0), whole, kept, seen, look);
#endif
  float weight = covers * cell * PS_COSINE(seen.direction);
  sum.nearness += weight * seen.nearness;
#ifdef PS_OCCLUSION
  const vec3 radiance = vec3(0.0);
#else
  vec3 radiance = (entered * seen.radiance + seen_back * (tiles ? look.inside : seen.radiance)) / max(whole, 1e-30);
#endif
  ps_covered[i] = covered;
  ps_inside[i] = inside;
  ps_weight[i] = of_cell * kept + weight;
#ifndef PS_OCCLUSION
  ps_light[i] = light * kept + radiance * weight;
#endif
  ps_left[i] = seen_back > 0.0 && tiles ? seen.nearness : latest;
#ifdef PS_MEDIA
  ps_distance[i] = ps_distance[i] * kept + weight / max(seen.nearness, 1e-30);
#endif
  uint full = covered >= PS_FULL ? 1u << uint((at.y & 3) * 8 + at.x) : 0u;
  ps_full |= at.y < 4 ? uvec2(full, 0u) : uvec2(0u, full);
  ps_add_glossy(sum, i, radiance, covers * cell, seen.direction, lobe);
}

#ifdef PS_CAPTURED
#include "lib/indirect/captured_parts.glsl"
#endif

#ifdef PS_BODIES
#include "lib/indirect/bodies.glsl"
#endif

// A piece of surface is smaller than a cell, and counts as a square of a cell's size around it: cells are then covered more evenly
// than by squares of its own size. Leaves and hairs together may be larger, and fill up to two by two cells, the nearest.
void ps_deposit(inout PsGathered sum, PsSeen seen, PsNodeLook look, vec4 lobe)
{
  float cell = ps_cell_solid_angle(seen.direction);
  vec2 centre = ps_cell_from_direction(seen.direction);
  vec2 nearest = floor(centre - 0.5);
  float reach = clamp(0.5 * seen.across * inversesqrt(cell), 0.5, 1.0);
  vec2 low = clamp(max(centre - reach, nearest), vec2(0.0), vec2(PS_CELLS));
  vec2 high = clamp(min(centre + reach, nearest + 2.0), vec2(0.0), vec2(PS_CELLS));
  vec2 sides = max(high - low, 1e-6);
  float share = 1.0 / (sides.x * sides.y);
  ivec2 first = ivec2(low);
#ifdef PS_BODIES
  seen.open = ps_open_before(centre, cell, seen, look);
#endif
  // Without a loop, whose turns would count.
  ps_cover(sum, first, low, high, share, cell, seen, look, lobe);
  ps_cover(sum, first + ivec2(1, 0), low, high, share, cell, seen, look, lobe);
  ps_cover(sum, first + ivec2(0, 1), low, high, share, cell, seen, look, lobe);
  ps_cover(sum, first + ivec2(1, 1), low, high, share, cell, seen, look, lobe);
}

// The first rows, so many, of four.
uint ps_rows(int count)
{
  return count == 4 ? 0xffffffffu : (1u << uint(8 * count)) - 1u;
}

// Whether all cells are covered that a ball may touch, so wide beside its distance, in a direction.
bool ps_behind(vec3 direction, float wide, float cell)
{
  vec2 centre = ps_cell_from_direction(direction);
  float reach = 0.5 + PS_WIDENED * wide * inversesqrt(cell);
  ivec2 low = max(ivec2(centre - reach), 0), high = min(ivec2(centre + reach), PS_CELLS - 1);
  uint row = ((2u << uint(high.x)) - (1u << uint(low.x))) * 0x01010101u;
  // Rows of the lower and upper half.
  ivec2 from = clamp(low.y - ivec2(0, 4), 0, 4), to = clamp(high.y + 1 - ivec2(0, 4), 0, 4);
  uvec2 rows = uvec2(ps_rows(to.x) & ~ps_rows(from.x), ps_rows(to.y) & ~ps_rows(from.y));
  return ((rows & row) & ~ps_full) == uvec2(0u);
}

// How large a node may be, over a cell.
float ps_sameness(PsNode node, float along)
{
  float turned = (node.bits & PS_IS_ROUGH) != 0 ? PS_ROUGH : PS_TURNED;
  float surface = (node.bits & PS_IS_ROUND) != 0 ? PS_ROUND : mix(turned, 1.0, along * along * along);
#ifdef PS_CAPTURED
  surface = (node.bits & PS_IS_CAPTURED) != 0 ? PS_SPLATS : surface;
#endif
  float scattered = (node.bits & PS_IS_ROUND) != 0 ? PS_HAIRS : PS_LEAVES;
  return (node.bits & PS_IS_SCATTERED) != 0 ? scattered : surface;
}

// Where the octants of a node meet. Surfels may all lie on one side of it, and so may their mean.
vec3 ps_cell_middle(PsNode node)
{
  float edge = u.cube.w * exp2(-float(floatBitsToInt(node.radius) & PS_LEVEL_BITS));
  return u.cube.xyz + (floor((node.position - u.cube.xyz) / edge) + 0.5) * edge;
}

// Octants `there`, a bit each, in the order of their distance from the octant `own`: bit k stands for the one that differs from it
// by k.
int ps_in_order(int there, int own)
{
  int x = (own & 1) != 0 ? (there & 0x55) << 1 | (there >> 1 & 0x55) : there;
  x = (own & 2) != 0 ? (x & 0x33) << 2 | (x >> 2 & 0x33) : x;
  return (own & 4) != 0 ? (x & 15) << 4 | x >> 4 : x;
}

// exp(asinh(x))
vec2 ps_exp_asinh(vec2 x)
{
  vec2 grown = abs(x) + sqrt(x * x + 1.0);
  return mix(1.0 / grown, grown, step(0.0, x));
}

// A leaf that is near: a rectangle, or half of one, of which parts are looked at, the smaller the nearer they are: x = h sinh(t)
// has steps of t that look alike from a height h above 0.
struct PsLeaf {
  vec3 middle;  // of the rectangle, from the receiver
  vec3 along, beside;  // its sides
  vec2 half_sides;
  vec2 foot, heights;  // of the receiver, over the rectangle
  vec2 from, factor;  // exp(t) at its edge, and that by which it grows from part to part
  ivec2 parts;
  bool triangle;
};

PsLeaf ps_leaf(PsNode node, PsNodeLook look, vec3 offset)
{
  PsLeaf leaf;
  vec3 f = look.axis;
  vec3 first = normalize(abs(f.z) < 0.7 ? vec3(f.y, -f.x, 0.0) : vec3(0.0, f.z, -f.y));
  PsLeafEdge edge = ps_leaf_edge(node);
  float side_length = sqrt(node.area);
  leaf.along = edge.turn.x * first + edge.turn.y * cross(f, first);
  leaf.beside = cross(f, leaf.along);
  leaf.triangle = edge.half_of_it;
  leaf.half_sides = (leaf.triangle ? 0.70710678 : 0.5) * side_length * vec2(edge.ratio, 1.0 / edge.ratio);
  // The middle of a triangle is a third of a half side away from that of its rectangle.
  vec2 third = leaf.half_sides * (leaf.triangle ? 1.0 / 3.0 : 0.0);
  leaf.middle = offset + third.x * leaf.along + third.y * leaf.beside;
  leaf.foot = -vec2(dot(leaf.middle, leaf.along), dot(leaf.middle, leaf.beside));
  vec2 off = max(abs(leaf.foot) - leaf.half_sides, 0.0);
  float least = node.first == -1 ? PS_LEAST_OF_ROUGH : PS_LEAST_HEIGHT;
  float height = max(abs(dot(f, offset)), least * side_length);
  leaf.heights = sqrt(height * height + off.yx * off.yx);
  leaf.from = ps_exp_asinh((-leaf.half_sides - leaf.foot) / leaf.heights);
  vec2 steps = log2(ps_exp_asinh((leaf.half_sides - leaf.foot) / leaf.heights) / leaf.from);
  bool is_leaf = node.first < 0 && look.along > 0.5;
  leaf.parts = is_leaf ? ivec2(clamp(ceil(PS_FINENESS * 0.69314718 * steps), 1.0, float(PS_MOST_PARTS))) : ivec2(1);
  leaf.factor = exp2(steps / vec2(leaf.parts));
  return leaf;
}

#ifdef PS_OCCLUSION
// How much of a piece lies within the distance that counts; `cosine`: between its normal and the way to it.
float ps_share_within(float away, float radius, float cosine)
{
  float deep = radius * sqrt(max(1.0 - cosine * cosine, 0.0));
  return clamp(0.5 + 0.5 * (u.within - away) / max(deep, 1e-6 * away), 0.0, 1.0);
}
#endif

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
#ifndef PS_OCCLUSION
    ps_light[i] = vec3(0.0);
#endif
    ps_inside[i] = 0.0;
#ifdef PS_SHINING
    ps_plane[i] = vec3(0.0);
    ps_quarters[i] = ps_earlier[i] = vec4(0.0);
#endif
    ps_left[i] = 0.0;
#ifdef PS_BODIES
    ps_body[i] = vec2(0.0);
    ps_exit[i] = ps_entry[i] = vec3(0.0);
#endif
#ifdef PS_CAPTURED
    ps_layer[i] = 0.0;
    ps_parts[4 * i] = ps_parts[4 * i + 1] = ps_parts[4 * i + 2] = ps_parts[4 * i + 3] = vec4(0.0);
    ps_before[4 * i] = ps_before[4 * i + 1] = ps_before[4 * i + 2] = ps_before[4 * i + 3] = vec4(0.0);
#endif
#ifdef PS_MEDIA
    ps_distance[i] = 0.0;
#ifdef PS_GLOSSY
    ps_mirrored[i] = vec3(0.0);
#endif
#endif
  }
  PsGathered sum = PsGathered(vec3(0.0), 0.0, vec3(0.0));
  // Of the latest node that was opened: its first child, which octants it has children in, which of these are left, in the order
  // of the walk, and the octant that the receiver is in. On the stack: those before that have some left.
  int first = u.root, there = 1, left = first < 0 ? 0 : 1, own = 0;  // media may be alone
  int firsts[PS_STACK], octants[PS_STACK];
  int size = 0, opened = 0;
  // Software rasterisers take both ways of each branch, and loops once more if they end before their last line: what is dear, to
  // see a piece, stands but once, and waits until all that run together have one.
  int number = 0, part = 0, count = 0;
  float tilt = 0.0;
  vec3 offset = vec3(0.0);
  vec2 low_exp = vec2(1.0);
  PsNode node;
  PsNodeLook look;
  PsLeaf leaf;
  do {
    int turns = 0;
    do {
      if (part >= count && left != 0) {
        int k = bitCount((left & -left) - 1);
        left &= left - 1;
        number = first + bitCount(there & ((1 << (own ^ k)) - 1));
        node = ps_node(number);
        offset = node.position - place.xyz;
        float height = dot(offset, n), d2 = max(dot(offset, offset), 1e-36), d = sqrt(d2);
        vec3 local = vec3(dot(offset, tangent), dot(offset, across), max(height, 0.0)) / d;
        float largest = min(PS_PI * node.radius * node.radius, 2.0 * node.area) / d2, along = ps_along(node);
        // How far it reaches above its middle, and how high its surface rises: as far as that is tilted.
        float axis_up = dot(ps_unpack_normal(node.axis), n), upright = along * axis_up;
        float reach = ps_thickness(node) * abs(axis_up) + sqrt(max(1.0 - axis_up * axis_up, 0.0));
        bool corners = node.first != -1 && (node.bits & (PS_IS_SCATTERED | PS_IS_ROUND)) == 0;
        bool above = height + min(reach, 1.0) * (corners ? PS_CORNERS : 1.0) * node.radius > PS_LOW * d;
        float cell = ps_cell_solid_angle(local);
        bool coarse = d < 1.5 * node.radius || largest > u.coarseness * cell * ps_sameness(node, along);
        above = above && (d < 1.5 * node.radius || !ps_behind(local, node.radius / d, cell));
#ifdef PS_OCCLUSION
        above = above && d - node.radius < u.within;
#endif
        opened += above ? 1 : 0;
        // What only stands for surfaces near it, as on thin pipes, would rise above the planes of others beside it.
        bool rough = node.first == -1 && (node.bits & (PS_IS_SCATTERED | PS_IS_ROUND)) == 0;
#ifdef PS_EVERY_SIDE
        // Of sheets of balls, which the horizon cuts, the other hemisphere, which is gathered as well, sees the rest.
        rough = rough && (node.bits & PS_IS_ROUGH) != 0;
#endif
        tilt = rough ? 0.0 : node.radius * sqrt(clamp(1.0 - upright * upright, 0.0, 1.0));
        part = 0;
        count = 0;
        if (above && node.first >= 0 && opened < PS_MOST_NODES && coarse && size < PS_STACK) {
          if (left != 0) {
            firsts[size] = first;
            octants[size] = there | left << 8 | own << 16;
            size++;
          }
          first = node.first;
          there = node.bits & 255;
          vec3 middle = ps_cell_middle(node) - place.xyz;
          own = (middle.x < 0.0 ? 1 : 0) | (middle.y < 0.0 ? 2 : 0) | (middle.z < 0.0 ? 4 : 0);
          left = ps_in_order(there, own);
        }
        else {
          float rise = node.first < -1 ? PS_CORNERS * tilt : tilt;
          count = above && height + rise > PS_ABOVE * node.radius ? 1 : 0;
        }
        if (left == 0 && size > 0) {
          size--;
          first = firsts[size];
          there = octants[size] & 255;
          left = octants[size] >> 8 & 255;
          own = octants[size] >> 16;
        }
      }
      turns++;
    } while (part >= count && left != 0 && turns < PS_TURNS);
    if (part < count) {
      if (part == 0) {
        look = ps_node_look(number, node);
        leaf = ps_leaf(node, look, offset);
        count = leaf.parts.x * leaf.parts.y;
        low_exp = leaf.from;
      }
      bool whole_leaf = count == 1;
      vec2 high_exp = low_exp * leaf.factor;
      vec2 low = 0.5 * leaf.heights * (low_exp - 1.0 / low_exp), high = 0.5 * leaf.heights * (high_exp - 1.0 / high_exp);
      part++;
      bool row_ends = part % leaf.parts.x == 0;
      low_exp = row_ends ? vec2(leaf.from.x, high_exp.y) : vec2(high_exp.x, low_exp.y);
      vec2 where = leaf.foot + 0.5 * (low + high), sides = high - low;
      float area = whole_leaf ? node.area : sides.x * sides.y;
      if (leaf.triangle && !whole_leaf) {
        // What of the part lies within the triangle.
        float begins = dot((leaf.foot + low) / leaf.half_sides + 1.0, vec2(0.5)), ends = dot((leaf.foot + high) / leaf.half_sides + 1.0, vec2(0.5));
        float within = clamp((1.0 - begins) / (ends - begins), 0.0, 1.0);
        area *= within < 0.5 ? 2.0 * within * within : 1.0 - 2.0 * (1.0 - within) * (1.0 - within);
      }
      vec3 to = whole_leaf ? offset : leaf.middle + where.x * leaf.along + where.y * leaf.beside;
      float rises = dot(to, n), of_part = whole_leaf ? tilt : tilt * max(sides.x, sides.y) * inversesqrt(node.area);
      float top = rises + of_part;
      float above = top > 0.0 ? smoothstep(0.0, max(2.0 * of_part, 1e-30), top) : 0.0;
      float away2 = max(dot(to, to), 1e-36), away = sqrt(away2);
      float signed_area = -dot(look.facing, to) / away, toward = -dot(look.axis, to) / away;
      float both = max(look.along * abs(toward) + 0.5 * (1.0 - look.along), abs(signed_area));
      both = ps_is_hairs(node) ? ps_shown_of_hairs(node, toward) : both;
      float angle = 0.5 * above * area / (away2 + area / (2.0 * PS_PI));
#ifdef PS_OCCLUSION
      angle *= ps_share_within(away, 0.5 * (whole_leaf ? 2.0 * node.radius : max(sides.x, sides.y)), look.along * toward);
#endif
      PsSeen seen;
      seen.single = node.first < 0 && look.solid;
      seen.nearness = 1.0 / away;
      seen.across = look.scattered ? PS_SPREAD * node.radius / away : 0.0;
#ifdef PS_CAPTURED
      float upright_to = max(look.along * abs(toward) + 1.0 - look.along, PS_LEAST_TILT);
      seen.upright = upright_to;
      seen.normal = vec3(dot(look.axis, tangent), dot(look.axis, across), dot(look.axis, n));
      seen.layer = 1.0 + PS_LAYER * max(sqrt(max(1.0 - upright_to * upright_to, 0.0)) / upright_to, 1.0);
#endif
      seen.front = (both + signed_area) * angle;
      seen.back = (both - signed_area) * angle;
      seen.direction = normalize(vec3(dot(to, tangent), dot(to, across), max(rises, 0.25 * top)));
      seen.radiance = toward > 0.0 ? look.before : look.behind;
#if defined(PS_SHINING) || defined(PS_BODIES)
      // Of surfaces that are turned to all sides it faces the receiver.
      vec3 plane = (1.0 - look.along) * to / away - sign(toward) * look.along * look.axis;
      plane /= max(dot(plane, to), PS_FLATTEST * away);
      seen.plane = vec3(dot(plane, tangent), dot(plane, across), dot(plane, n));
#endif
#ifdef PS_BODIES
      seen.fine = (node.bits & PS_IS_ROUGH) != 0;
#endif
#ifdef PS_SHINING
      seen.shining = (node.bits & PS_IS_SHINING) != 0;
#endif
#ifdef PS_CAPTURED
      if (top > 0.0 && look.captured) {
        ps_deposit_parts(sum, seen, lobe);
      }
      if (top > 0.0 && !look.captured) {
#else
      if (top > 0.0) {
#endif
        ps_deposit(sum, seen, look, lobe);
      }
    }
  } while (part < count || left != 0);

#ifdef PS_MOMENTS
  vec3 moment_0 = vec3(0.0), moment_x = vec3(0.0), moment_y = vec3(0.0), moment_z = vec3(0.0), surfaces_0 = vec3(0.0);
  vec4 second = vec4(0.0), open_sky = vec4(0.0);
  float last = 0.0;
#endif
  float of_sky = 0.0, whole = 0.0, whole_lobe = 0.0, open_lobe = 0.0;
  for (int y = 0; y < PS_CELLS; y++) {
    for (int x = 0; x < PS_CELLS; x++) {
      float weight = 0.0, angle = 0.0;
      for (int k = 0; k < 4; k++) {
        vec3 part = ps_direction_from_cell(vec2(x, y) + vec2(k & 1, k >> 1) * 0.5 + 0.25);
        float of_part = 0.25 * ps_cell_solid_angle(part);
        angle += of_part;
        weight += of_part * PS_COSINE(part);
      }
      vec3 direction = ps_direction_from_cell(vec2(x, y) + 0.5);
      int i = y * PS_CELLS + x;
      float covered = ps_covered[i], tight = ps_tight(covered), left = 1.0 - tight;
#ifdef PS_SHINING
      covered = 0.25 * dot(ps_quarters[i], vec4(1.0));
      float scale = ps_tight(covered) / max(covered, 1e-6), of_covered = tight / max(covered, 1e-6);
#else
      float scale = tight / max(covered, 1e-6), of_covered = scale;
#endif
#ifdef PS_MEDIA
      float surface = covered > 0.0 ? ps_distance[i] / max(ps_weight[i], 1e-30) : 0.0;
      PsMarch air = PsMarch(vec3(0.0), PS_SHARE(0.0), vec3(0.0), PS_SHARE(0.0));
      float all_shares = 0.0;
      for (int k = 0; k < PS_RAYS * PS_RAYS; k++) {
        vec3 part = ps_direction_from_cell(vec2(x, y) + (vec2(k % PS_RAYS, k / PS_RAYS) + 0.5) / float(PS_RAYS));
        PsMarch one = ps_march(place.xyz, part.x * tangent + part.y * across + part.z * n, surface);
        float share = ps_cell_solid_angle(part) * PS_COSINE(part);
        all_shares += share;
        air.before += share * one.before;
        air.left_before += share * one.left_before;
        air.all += share * one.all;
        air.left += share * one.left;
      }
      air.before /= all_shares;
      air.left_before /= all_shares;
      air.all /= all_shares;
      air.left /= all_shares;
      vec3 sent = mix(air.all, air.before, tight);
#endif
#if defined(PS_OCCLUSION)
      const vec3 of_surfaces = vec3(0.0);
#elif defined(PS_MEDIA)
      vec3 of_surfaces = ps_light[i] * (scale * air.left_before) + weight * sent;
#else
      vec3 of_surfaces = ps_light[i] * scale;
#endif
      sum.diffuse += of_surfaces;
      // What is open of a cell that is covered in part is where it is not: on the other side of its middle.
      float left_weight = left > 1e-3 ? clamp(weight - ps_weight[i] * of_covered, 0.0, weight) : 0.0;
      whole += weight;
#ifdef PS_OCCLUSION
      sum.nearness += left_weight / u.within;  // as far away begins what does not count
#endif
#ifdef PS_GLOSSY
      float of_lobe = angle * ps_lobe(direction, lobe);
      whole_lobe += of_lobe;
#ifdef PS_MEDIA
      sum.glossy += ps_mirrored[i] * air.left_before + of_lobe * sent;
      open_lobe += left * of_lobe * dot(vec3(air.left), vec3(1.0 / 3.0));
#else
      open_lobe += left * of_lobe;
#endif
#endif
      vec3 sky = vec3(0.0);
#if defined(PS_HAS_WORLD)
      sky = texelFetch(ps_lights, ivec2(0, PS_WORLD_ROW), 0).rgb;
#elif defined(PS_HAS_ENVIRONMENT)
      float of_parts = 0.0;
      for (int k = 0; k < (left > 0.0 ? PS_SKY_PARTS * PS_SKY_PARTS : 0); k++) {
        vec2 within = (vec2(k % PS_SKY_PARTS, k / PS_SKY_PARTS) + 0.5) / float(PS_SKY_PARTS);
        vec3 part = ps_direction_from_cell(vec2(x, y) + within);
        float share = ps_cell_solid_angle(part) * PS_COSINE(part);
        vec3 world = part.x * tangent + part.y * across + part.z * n;
        sky += share * ps_environment_level(ps_uv_from_direction(ps_image_from_view(world)), PS_GATHERED_LEVEL);
        of_parts += share;
      }
      sky /= max(of_parts, 1e-30);
#endif
      sky *= u.sky * left_weight;
#ifdef PS_MEDIA
      sky *= air.left;
#endif
      sum.diffuse += sky;
      of_sky += dot(sky, vec3(1.0 / 3.0));
#ifdef PS_MOMENTS
      vec3 to = direction.x * tangent + direction.y * across + direction.z * n, all = of_surfaces + sky;
      moment_0 += all;
      moment_x += all * to.x;
      moment_y += all * to.y;
      moment_z += all * to.z;
      float mean = dot(all, vec3(1.0 / 3.0));
      second += mean * vec4(to.x * to.y, to.y * to.z, 3.0 * to.z * to.z - 1.0, to.x * to.z);
      last += mean * (to.x * to.x - to.y * to.y);
      surfaces_0 += of_surfaces;
      float shows = left_weight;
#ifdef PS_MEDIA
      shows *= dot(vec3(air.left), vec3(1.0 / 3.0));
#endif
      open_sky += vec4(1.0, to) * shows;
#endif
    }
  }
#ifdef PS_MOMENTS
  out_moments_0 = vec4(moment_0, moment_x.r);
  out_moments_1 = vec4(moment_x.gb, moment_y.rg);
  out_moments_2 = vec4(moment_y.b, moment_z);
  out_moments_3 = second;
  out_moments_4 = vec4(last, surfaces_0);
  out_moments_5 = open_sky;
#else
#ifdef PS_GLOSSY
  out_glossy = vec4(sum.glossy, open_lobe) / max(whole_lobe, 1e-30);
#endif
#ifdef PS_BOUNCES
  sum.nearness = of_sky;
#endif
  out_diffuse = vec4(sum.diffuse, sum.nearness) / whole;
#endif
}
