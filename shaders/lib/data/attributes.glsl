// What a splat brings to the surfel that shows it, beside its shape and its normal.

PsSurfel ps_attributed(PsSurfel s, ivec3 element)
{
#ifdef PS_COLOR
  s.color.rgb = texelFetch(ps_color, element.xy, 0).rgb;
#endif
#ifdef PS_SURFACE
  vec2 surface = texelFetch(ps_surface, element.xy, 0).xy;
  s.normal.w = surface.x;
  s.color.w = surface.y;
#endif
#ifdef PS_EMISSION
  s.emission = texelFetch(ps_emission, element.xy, 0);
#endif
#ifdef PS_OWNER
  s.owner = uint(element.z);
#endif
#ifdef PS_VELOCITY
  s.velocity = ps_linear(element.z) * texelFetch(ps_velocity, element.xy, 0).xyz;
#endif
#ifdef PS_HOLDOUT
  if (ps_instance_row(element.z, 3).x > 0.5) {
    s.shape.w = -1.0 - s.shape.w;
  }
#endif
  return s;
}
