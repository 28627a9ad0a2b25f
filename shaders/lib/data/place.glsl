// The half extent of a surfel in depth, place.w, also says what it is: lib/surfel.glsl.

#define PS_POLYGON -1e30
// Of what extends over its own pixel only, place.y says whether it is a strand, whose normal is its tangent.
#define PS_STRAND 1.0

// Whether something covers the pixel's centre.
bool ps_is_there(vec4 place)
{
  return place.w > 0.0 || place.w <= PS_POLYGON;
}

bool ps_is_strand(vec4 place)
{
  return place.w <= PS_POLYGON && place.y > 0.5 * PS_STRAND;
}
