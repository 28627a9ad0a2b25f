// Which samples a triangle covers whose alpha is below 1: that share of them. A sample has a threshold in [0, 1), and is covered
// where alpha is above it. Thresholds of a pixel's samples are evenly spaced, those of 17 neighbouring pixels lie between each
// other's, and those of a picture's further samples follow by an irrational step. Triangles behind each other multiply their
// transmittances: each has multipliers, an offset and a step of its own, which stay as it moves. PS_RANKS: sub-samples of a pixel.

#include "lib/visibility/ranks.glsl"

#define PS_PIXELS 17.0  // of which thresholds differ: those of a lattice (4, -1; 1, 4)

// Two multipliers, an offset and a step. Multipliers are those by which consecutive ranks lie farthest apart, steps are continued
// fractions that end with ones, whose multiples are the most even.
vec4 ps_cut_of(int triangle, int instance)
{
  uint h = uint(triangle) * 0x9E3779B1u ^ uint(instance) * 0x27D4EB2Fu;
  h = (h ^ (h >> 15u)) * 0x2C1B3C6Du;
  h = (h ^ (h >> 12u)) * 0x297A2D39u;
  h ^= h >> 15u;
#if PS_RANKS == 17
  uint first = 6u + h % 6u;
#else
  uint first = 1u + h % uint(max(PS_RANKS - 1, 1));
#endif
  float step = 1.0 / (float(1u + (h & 3u)) + 1.0 / (float(1u + ((h >> 2u) & 3u)) + 0.618033989));
  return vec4(float(first), float(6u + (h >> 4u) % 6u), float(h >> 8u) / 16777216.0, step);
}

bool ps_is_cut_out(float alpha, vec4 cut, float rank, vec2 pixel)
{
  float neighbour = cut.y * ps_modulo(floor(pixel.x) + 13.0 * floor(pixel.y), PS_PIXELS) / PS_PIXELS;
  float threshold = fract((cut.x * rank + neighbour) / float(PS_RANKS) + cut.z + cut.w * float(u.sample_index));
  return alpha <= threshold;
}
