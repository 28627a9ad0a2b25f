// The kind of a surfel: its half extent in depth, centre.w, tells it: lib/geometry/surfel.glsl.

#define PS_POLYGON -1e30
// Of what extends over its own pixel only, centre.y says whether it is a strand, whose normal is its tangent; else it is 0 or
// the spread of a group's normals (lib/visibility/normal_spread.glsl), which is never less.
#define PS_STRAND -1.0
// And centre.z is 0 where its normal is that of its plane, on either side; else 1 + the packed normal of the plane, on the side
// that is seen, as the normal is; of groups of sub-samples shape.z is how far what it stands for bulges above it, in pixels: half
// floats hold these in worlds of any size.
// Of groups of sub-samples it is PS_BALL for balls, whose sub-samples have normals of their own, and less for nodes of balls.
#define PS_BALL -1.0
// Of strands it is 0 or less, but more than PS_BALL: their number, of so many, over that.
#define PS_STRAND_NUMBERS 1048576.0

// In the channel that holds the material: a mesh that stands for captured surfaces.
#define PS_MATTE -0.5

bool ps_is_matte(vec4 shape)
{
  return abs(shape.w - PS_MATTE) < 0.25;
}

// Whether something covers the pixel's centre.
bool ps_is_there(vec4 centre)
{
  return centre.w > 0.0 || centre.w <= PS_POLYGON;
}

bool ps_is_strand(vec4 centre)
{
  return centre.w <= PS_POLYGON && centre.y < 0.5 * PS_STRAND;
}

uint ps_strand_number(vec4 centre)
{
  return ps_is_strand(centre) ? uint(-centre.z * PS_STRAND_NUMBERS + 0.5) : 0u;
}
