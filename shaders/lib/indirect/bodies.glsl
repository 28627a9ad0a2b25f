// How bodies of fine triangles hide what lies behind them in the cells of a hemisphere. Included by indirect/gather.frag, whose
// PsSeen and cells it reads.

// A cell has left a body of fine triangles where it shows so much of backs, over fronts, in pieces that show so many times more of
// these; behind it lies what is so many times as far away as the plane of the latest such back. A front of fine triangles is another
// body, too, that lies behind the plane of the first front by so much of its distance, half a cell.
#define PS_HAS_LEFT 0.3
#define PS_CLEARLY 1.3
#define PS_BEHIND 1.01
#define PS_DEEP 0.16

vec2 ps_body[PS_CELLS * PS_CELLS];  // covered before the latest body; of its backs, what was seen beyond PS_HAS_LEFT of its fronts
vec3 ps_entry[PS_CELLS * PS_CELLS];  // plane of the first front of fine triangles, its normal over its distance; 0: none
vec3 ps_exit[PS_CELLS * PS_CELLS];  // of the latest such back

// The share of a piece that bodies before it leave open, by what the cell shows that its middle lies in.
float ps_open_before(vec2 centre, float cell, PsSeen seen, PsNodeLook look)
{
  ivec2 at = clamp(ivec2(centre), 0, PS_CELLS - 1);
  int i = at.y * PS_CELLS + at.x;
  vec2 body = ps_body[i];
  vec3 entry = ps_entry[i], exit = ps_exit[i];
  float entered = look.scattered ? 0.0 : seen.front / cell, left = look.scattered ? 0.0 : seen.back / cell;
  bool enters = entered > PS_CLEARLY * left, leaves = seen.fine && left > PS_CLEARLY * entered;
  bool after = body.y >= 0.0 && dot(exit, seen.direction) > PS_BEHIND * seen.nearness;
  bool deep = seen.fine && dot(entry, seen.direction) - seen.nearness > PS_DEEP * length(entry);
  bool begins = enters && (after || deep);
  body = begins ? vec2(ps_covered[i], 0.0) : body;
  ps_body[i] = vec2(body.x, body.y + (leaves ? left : 0.0) - PS_HAS_LEFT * entered);
  ps_entry[i] = seen.fine && enters && (begins || entry == vec3(0.0)) ? seen.plane : entry;
  ps_exit[i] = leaves ? seen.plane : exit;
  return 1.0 - body.x;
}
