// One texel a tile: the number of samples that were enough for it, 0 where they were not. What counts is the tile's worst
// pixel: how far the mean of all samples is from the mean of their first half (of 2 n + 1, the first n + 1), over the
// square root of the brightness.

#define PS_DARKEST 1e-2  // brightness below which differences count as if it were this

void main()
{
  ivec2 tile = ivec2(gl_FragCoord.xy);
  float before = texelFetch(ps_counts, tile, 0).x;
  ivec2 corner = tile * PS_TILE;
  ivec2 end = min(corner + PS_TILE, textureSize(ps_combined, 0));
  float done = float(u.samples);
  float worst = 0.0;
  if (before == 0.0) {
    for (int y = corner.y; y < end.y; y++) {
      for (int x = corner.x; x < end.x; x++) {
        vec4 mean = texelFetch(ps_combined, ivec2(x, y), 0) / done;
        vec4 difference = abs(mean - texelFetch(ps_half, ivec2(x, y), 0) * (2.0 / (done + 1.0)));
        float bright = max(mean.r + mean.g + mean.b, PS_DARKEST);
        worst = max(worst, (difference.r + difference.g + difference.b) / sqrt(bright) + difference.a);
      }
    }
  }
  // A difference that is no number never converges.
  out_count = before != 0.0 ? before : worst <= u.threshold ? done : 0.0;
}
