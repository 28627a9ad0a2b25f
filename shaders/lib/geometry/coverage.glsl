// How much of a pixel is covered. PS_COVERAGE: splats that were blended have soft edges (shaders/ewa/normalise.frag), of
// which shape.x knows how much their kernels cover. Within a surface, where that is a little uneven, pixels are whole.

float ps_coverage(ivec2 pixel, vec4 centre)
{
#ifdef PS_COVERAGE
  if (centre.w == 0.0 || centre.w <= PS_POLYGON) {
    return centre.w == 0.0 ? 0.0 : 1.0;
  }
  ivec2 last = textureSize(ps_centre, 0) - 1;
  int around = centre.w > 0.0 ? 0 : 9;
  while (around < 9 && ps_is_there(texelFetch(ps_centre, clamp(pixel + ivec2(around % 3, around / 3) - 1, ivec2(0), last), 0))) {
    around++;
  }
  return centre.w > 0.0 && around == 9 ? 1.0 : texelFetch(ps_shape, pixel, 0).x;
#else
  return ps_is_there(centre) ? 1.0 : 0.0;
#endif
}
