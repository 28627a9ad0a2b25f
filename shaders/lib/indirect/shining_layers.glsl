// How what emits light hides what lies behind it in the cells of a hemisphere: in quarters of each. Included by
// indirect/gather.frag, whose PsSeen it reads.

// Half a cell: how far behind the plane of what emits light others lie at least that it hides, over its distance.
#define PS_BEYOND 0.16

vec4 ps_quarters[PS_CELLS * PS_CELLS];  // shares of the cell's quarters that are covered, where layers hide each other
vec4 ps_earlier[PS_CELLS * PS_CELLS];  // and what was covered of them by layers before the latest
vec3 ps_plane[PS_CELLS * PS_CELLS];  // of what emits light in that: its normal over its distance

// How much more of a cell is covered by a piece, `whole` of it in the rectangle from `low` to `high` of its sides; `kept`: of what it
// was covered by.
float ps_cover_quarters(int i, vec2 low, vec2 high, float whole, float kept, PsSeen seen, PsNodeLook look)
{
  vec2 first = clamp((0.5 - low) / max(high - low, 1e-6), 0.0, 1.0);
  vec4 wanted = 4.0 * whole * vec4(first, 1.0 - first).xzxz * vec4(first.yy, 1.0 - first.yy);
  vec4 quarters = ps_quarters[i] * kept, earlier = min(ps_earlier[i], quarters);
  vec3 plane = ps_plane[i];
  bool counts = whole > 0.0 && !look.scattered;
  bool next = counts && dot(plane, seen.direction) - seen.nearness > PS_BEYOND * length(plane);
  earlier = next ? quarters : earlier;
  bool begins = counts && seen.shining && (next || plane == vec3(0.0));
  ps_plane[i] = begins ? seen.plane : next ? vec3(0.0) : plane;
  ps_earlier[i] = earlier;
  vec4 room = 1.0 - quarters;
  wanted = look.scattered ? (seen.single ? min(wanted, 1.0) : 1.0 - exp(-wanted)) * room : wanted * (1.0 - earlier);
  vec4 got = min(wanted, room);
  // What finds its own quarters covered covers the others.
  float rest = dot(wanted - got, vec4(1.0)), gaps = dot(room - got, vec4(1.0));
  got += (room - got) * min(rest / max(gaps, 1e-6), 1.0);
  ps_quarters[i] = quarters + got;
  return 0.25 * dot(got, vec4(1.0));
}
