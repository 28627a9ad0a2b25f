// What a strand's material is at a point of it.

#include "lib/geometry/surfel.glsl"
#include "lib/strands/segment.glsl"

void ps_strand_attributes(inout PsSurfel s, PsSegment segment, float along)
{
#ifdef PS_COLOR
  s.color.rgb = mix(texelFetch(ps_color, segment.from, 0).rgb, texelFetch(ps_color, segment.to, 0).rgb, along);
#endif
#ifdef PS_SURFACE
  vec2 surface = mix(texelFetch(ps_surface, segment.from, 0).xy, texelFetch(ps_surface, segment.to, 0).xy, along);
  s.normal.w = surface.x;
  s.color.w = surface.y;
#endif
#ifdef PS_EMISSION
  s.emission = vec4(mix(texelFetch(ps_emission, segment.from, 0).rgb, texelFetch(ps_emission, segment.to, 0).rgb, along),
                    0.0);
#endif
#ifdef PS_OWNER
  s.owner = uint(segment.instance);
#endif
}
