// Irradiance over pi that lamps shine on surfels, one texel each. ps_surfels: places and normals in view space.
// PS_MEDIUM: mean radiance by lamps over all directions instead, at places in media.

#include "lib/light/lights.glsl"

void main()
{
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 place = texelFetch(ps_surfels, ivec2(2 * at.x, at.y), 0).xyz;
  vec3 normal = texelFetch(ps_surfels, ivec2(2 * at.x + 1, at.y), 0).xyz;
  if (dot(normal, normal) == 0.0) {
    discard;
  }
#ifdef PS_MEDIUM
  ivec4 ends = ps_light_ends();
  vec3 sum = vec3(0.0);
  for (int i = 0; i < u.light_count; i++) {
    vec3 to_light, irradiance = ps_ball_irradiance(i, ends, place, to_light);
    sum += ps_reaching(i, irradiance, place, vec3(0.0));
  }
  out_light = vec4(sum / (4.0 * PS_PI), 1.0);
#else
  PsSurface white;
  white.base = vec3(1.0);
  white.emission = vec3(0.0);
  white.roughness = 1.0;
  white.metallic = 0.0;
  white.eta = 1.0;  // no lobe but the diffuse one
  PsLobes lobes = ps_lobes(white, normal, vec3(0.0), normal);
  out_light = vec4(ps_shade_lights(place, lobes, u.light_count), 1.0);
#endif
}
