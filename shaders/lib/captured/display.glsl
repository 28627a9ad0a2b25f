// Display values (sRGB) that captured splats were trained with, and scene-linear ones.

vec3 ps_linear_from_display(vec3 c)
{
  return mix(c / 12.92, pow((max(c, 0.04045) + 0.055) / 1.055, vec3(2.4)), vec3(greaterThan(c, vec3(0.04045))));
}

vec3 ps_display_from_linear(vec3 c)
{
  return mix(c * 12.92, 1.055 * pow(max(c, 0.0031308), vec3(1.0 / 2.4)) - 0.055, vec3(greaterThan(c, vec3(0.0031308))));
}
