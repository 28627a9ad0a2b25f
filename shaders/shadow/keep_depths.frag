// Depths of one view from a light into their place among all maps, as floats; where nothing casts, beyond everything.

#define PS_NOTHING 3e38

void main()
{
  uint bits = texelFetch(ps_depths, ivec2(gl_FragCoord.xy) - u.corner, 0).x;
  out_depth = bits == 0xFFFFFFFFu ? PS_NOTHING : uintBitsToFloat(bits) + u.near;
}
