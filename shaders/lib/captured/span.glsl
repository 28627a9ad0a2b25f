// Four places that divide the way between two, (low, high), into five parts, rounded up.
vec4 ps_places_between(vec2 span)
{
  return span.x + ceil((span.y - span.x) * vec4(0.2, 0.4, 0.6, 0.8));
}
