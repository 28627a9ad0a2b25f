// Eye-dome lighting (Boucheny 2009) of a finished picture: a pixel is darker the more its neighbours lie in front of it. The
// reference is tests/reference/eye_dome.py.

#include "lib/geometry/surfel_kind.glsl"

// How many times as far away one depth is as a nearer one, as a binary logarithm; 0 where it is not nearer.
float ps_behind(float depth, float nearer)
{
  float step = max(depth - nearer, 0.0);
  // A parallel view has no eye to be far from: what counts is the step beside the picture's width.
  return log2(1.0 + step / (u.perspective == 1 ? max(nearer, 1e-30) : u.width));
}

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy), size = textureSize(ps_centre, 0);
  out_color = texelFetch(ps_combined, pixel, 0);
  vec4 centre = texelFetch(ps_centre, pixel, 0);
  if (!ps_is_there(centre)) {
    return;
  }
  float sum = 0.0;
  for (int i = 0; i < PS_NEIGHBOURS; i++) {
    float angle = PS_TURN * float(i);
    vec2 away = u.radius * vec2(cos(angle), sin(angle));
    ivec2 other = pixel + ivec2(sign(away) * floor(abs(away) + 0.5));
    vec4 found = texelFetch(ps_centre, clamp(other, ivec2(0), size - 1), 0);
    sum += ps_is_there(found) ? ps_behind(centre.x, found.x) : 0.0;
  }
  out_color.rgb *= exp(-u.strength * sum / float(PS_NEIGHBOURS));
}
