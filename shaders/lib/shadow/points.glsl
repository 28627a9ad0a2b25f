// Which points of a light with a size are looked at: terms of an additive recurrence in five dimensions (Roberts 2018), two on the
// light, two in a cell of a table, one along the ray.
// PS_SHADOW_SPREAD: receivers have numbers of their own, and each looks at other points than its neighbours. What blends many of
// them, as the voxels along a ray, or strands within a pixel, then sees all of the light, though each looks at few points of it; and
// as numbers belong to receivers, not to pixels, nothing flickers where a camera moves.

#define PS_POINT_X 3785032107u  // 2^32 times the steps of the recurrence
#define PS_POINT_Y 3335640777u
#define PS_POINT_ROW 2939605023u
#define PS_POINT_COLUMN 2590590015u
#define PS_POINT_CUT 2283013049u
#define PS_POINT_SAMPLES 2891u  // from one sample of a picture to the next: terms that lie evenly between each other

#ifdef PS_SHADOW_SPREAD
#define PS_EVERY_POINT 1024
struct PsSpread {
  uint number;  // of the receiver
  int points;  // of a light, at most, that it looks at
};
PsSpread ps_spread;
#endif

// A number of the recurrence, from 0 to 1; its terms for successive integers fill the unit interval evenly.
float ps_point_sequence(uint index, uint step)
{
  return float((index * step + 0x80000000u) >> 8u) * (1.0 / 16777216.0);
}
