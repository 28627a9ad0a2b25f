// The cones of spot lights. For lights.glsl.

#ifdef PS_HAS_SPOTS

struct PsCone {
  vec3 direction;
  vec4 axis_u;  // w: cosine of half the angle
  vec4 axis_v;  // w: 1 / range of cosines of the blend
};

float ps_cone(PsCone cone, vec3 ray)
{
  vec3 local = vec3(dot(ray, cone.axis_u.xyz), dot(ray, cone.axis_v.xyz), dot(ray, cone.direction));
  float z = local.z * inversesqrt(max(dot(local, local), 1e-30));
  float t = clamp((z - cone.axis_u.w) * cone.axis_v.w, 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

#ifdef PS_HAS_WIDE_LIGHTS

// Means of the cone over the light's disk: plain, and weighted with n.l.
vec2 ps_cone_means(PsCone cone, vec3 ray, float radius, vec3 normal)
{
  // Aligned with the cone, so that the camera's turning changes nothing.
  vec3 to_light = -ray * inversesqrt(max(dot(ray, ray), 1e-24));
  bool aside = abs(dot(to_light, cone.direction)) < 0.999;
  vec3 side_u = normalize(cross(aside ? cone.direction : cone.axis_u.xyz, to_light));
  vec3 side_v = cross(to_light, side_u);
  float step = abs(radius) * PS_DISK_RADIUS;
  int count = radius == 0.0 ? 1 : 7;
  vec2 azimuth = vec2(0.0), total = vec2(0.0), weights = vec2(0.0);
  float part = 0.25;
  for (int i = 0; i < count; i++) {
    vec3 from_point = ray - step * (azimuth.x * side_u + azimuth.y * side_v);
    vec2 weight = part * vec2(1.0, max(-dot(from_point, normal), 0.0));
    total += ps_cone(cone, from_point) * weight;
    weights += weight;
    azimuth = ps_next_azimuth(azimuth);
    part = 0.125;
  }
  float plain = total.x / weights.x;
  return vec2(plain, weights.y > 0.0 ? total.y / weights.y : plain);
}

#endif

vec3 ps_spot(int index, vec3 position, PsLobes lobes)
{
  vec4 color = ps_light(index, 0), light_position = ps_light(index, 1), direction = ps_light(index, 2);
  PsCone cone = PsCone(direction.xyz, ps_light(index, 3), ps_light(index, 4));
  PsReceived received = ps_local_light(lobes, light_position.xyz - position, direction.w);
#ifdef PS_HAS_WIDE_LIGHTS
  vec2 share = ps_cone_means(cone, position - light_position.xyz, direction.w, lobes.normal);
#else
  vec2 share = vec2(ps_cone(cone, position - light_position.xyz));
#endif
  received.specular *= share.x;
  received.irradiance *= share.y;
  return ps_reflected(received, lobes, color, light_position.w);
}

#endif
