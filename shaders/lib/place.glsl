// The half extent of a surfel in depth, place.w, also says what it is: lib/surfel.glsl.

#define PS_POLYGON -1e30

// Whether something covers the pixel's centre.
bool ps_is_there(vec4 place)
{
  return place.w > 0.0 || place.w <= PS_POLYGON;
}
