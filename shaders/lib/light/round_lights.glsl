// Suns, point lights and spots: cones of light around one direction. For lights.glsl.

#ifdef PS_HAS_ROUND_LIGHTS

#ifdef PS_HAS_WIDE_LIGHTS

// Irradiance of a bright cone over that of the same cone overhead, cut by the horizon (Snyder 1996).
float ps_cap_cosine(float cosine, float sine2)
{
  sine2 = clamp(sine2, 0.0, 1.0);
  float sin_theta = sqrt(max(1.0 - cosine * cosine, 1e-12));
  float x = sqrt(max(1.0 / max(sine2, 1e-12) - 1.0, 0.0));
  float y = clamp(-x * cosine / sin_theta, -1.0, 1.0);
  float up = sqrt(1.0 - y * y), chord = sin_theta * up;
  // atan throughout: some drivers' acos and asin are good to 1e-4 only.
  float cut = max(cosine * atan(up, y) - x * chord + atan(chord, x) / sine2, 0.0) / PS_PI;
  // Narrow cones change within a fraction of their own width only, and would cancel.
  return sine2 < 1e-4 || abs(cosine) >= sqrt(sine2) ? max(cosine, 0.0) : cut;
}

// Mean of BSDF times n.l over a cone of light.
vec3 ps_cone_specular(PsLobes lobes, vec3 to_light, float sine2, float cosine)
{
  float sigma = atan(sqrt(sine2), cosine);
  vec3 side = lobes.mirror - dot(lobes.mirror, to_light) * to_light;
  float away = length(side);
  side /= max(away, 1e-9);
  vec3 other = cross(to_light, side);

  // Wide lobes: seven points of the light. Only the centre, where all of it is as one point.
  float narrow = ps_narrow(lobes, sigma);
  bool small = ps_is_small(lobes, sigma);
  int count = small || narrow == 1.0 ? 1 : 7;
  float a2 = ps_widened_alpha2(lobes, sigma);
  float turn = PS_DISK_RADIUS * sigma;
  float sin_turn = sin(turn), cos_turn = cos(turn);
  vec2 azimuth = vec2(0.0);
  float weight = small ? 1.0 : 0.25;
  vec3 direction = to_light, lobe = vec3(0.0);
  for (int i = 0; i < count; i++) {
    lobe += weight * ps_specular(lobes, direction, a2);
    azimuth = ps_next_azimuth(azimuth);
    direction = cos_turn * to_light + sin_turn * (azimuth.x * side + azimuth.y * other);
    weight = 0.125;
  }

  // Narrow ones: the share of the lobe that the light fills.
  float angle = atan(away, dot(lobes.mirror, to_light));
  float width = ps_width_along(lobes, cross(other, lobes.mirror));
  float share = ps_disk_share(angle, sigma, width, ps_width_along(lobes, other));
  float solid_angle = 2.0 * PS_PI * sine2 / (1.0 + cosine);
  return mix(lobe, lobes.reflectance * share / max(solid_angle, 1e-20), narrow);
}

#endif

#ifdef PS_SPREAD

#define PS_HALF_RANGE 1.6  // of an even distribution about 0 with the positive part of a Gaussian's, in its deviations

// Mean of max(n.l, 0) over normals with a spread about the mean, and over a cone of light. Normals of which some face the
// light and some do not are taken to be spread evenly.
float ps_spread_cosine(float cosine, float spread, float sine2)
{
  float length2 = 1.0 / (1.0 + spread);
  float middle = cosine * sqrt(length2);
  float range = PS_HALF_RANGE * sqrt(0.5 * spread * length2 * max(1.0 - cosine * cosine, 0.0) + 0.25 * sine2);
  return abs(middle) < range ? (middle + range) * (middle + range) / (4.0 * range) : max(middle, 0.0);
}

#endif

// A light that fills a cone around to_light, of which sine2 is the squared sine of half the angle. scale: irradiance
// of a surface that faces it.
PsReceived ps_round_light(PsLobes lobes, vec3 to_light, float sine2, float scale)
{
  float facing = dot(lobes.normal, to_light);
#ifdef PS_HAS_WIDE_LIGHTS
  float received = ps_cap_cosine(facing, sine2);
#else
  float received = max(facing, 0.0);
#endif
#ifdef PS_SPREAD
  received = lobes.spread > 0.0 ? ps_spread_cosine(facing, lobes.spread, sine2) : received;
#endif
#ifdef PS_HAS_WIDE_LIGHTS
  float cosine = sqrt(max(1.0 - sine2, 0.0));
  float energy = scale * 2.0 / (1.0 + cosine);
  return ps_received(scale * received, energy * ps_cone_specular(lobes, to_light, sine2, cosine), lobes, to_light);
#else
  return ps_received(scale * received, scale * ps_specular(lobes, to_light, lobes.alpha * lobes.alpha), lobes, to_light);
#endif
}

vec3 ps_sun(int index, PsLobes lobes)
{
  vec4 color = ps_light(index, 0), to_light = ps_light(index, 1);
#ifdef PS_HAS_WIDE_LIGHTS
  float sine2 = ps_light(index, 2).w;
#else
  float sine2 = 0.0;
#endif
  return ps_reflected(ps_round_light(lobes, to_light.xyz, sine2, 1.0), lobes, color, to_light.w);
}

// A point or spot light without its cone. `radius` is negative for a sphere, positive for a disk that faces the
// surface, which is seen as a cone, as a sphere is, only under a smaller angle.
PsReceived ps_local_light(PsLobes lobes, vec3 offset, float radius)
{
  float d2 = max(dot(offset, offset), 1e-24);
  vec3 to_light = offset * inversesqrt(d2);
#ifdef PS_HAS_WIDE_LIGHTS
  float r2 = radius * radius;
  float distance2 = radius < 0.0 ? max(d2, r2) : d2 + r2;
  PsReceived received = ps_round_light(lobes, to_light, r2 / distance2, 1.0 / distance2);
  // Inside a sphere light comes from everywhere.
  received.irradiance = radius < 0.0 && d2 < r2 ? 1.0 / distance2 : received.irradiance;
  return received;
#else
  return ps_round_light(lobes, to_light, 0.0, 1.0 / d2);
#endif
}

vec3 ps_point(int index, vec3 position, PsLobes lobes)
{
  vec4 color = ps_light(index, 0), light_position = ps_light(index, 1);
#ifdef PS_HAS_WIDE_LIGHTS
  float radius = ps_light(index, 2).w;
#else
  float radius = 0.0;
#endif
  return ps_reflected(ps_local_light(lobes, light_position.xyz - position, radius), lobes, color, light_position.w);
}

#ifdef PS_HAS_SPOTS

#ifdef PS_HAS_WIDE_LIGHTS

#define PS_CONE_POINTS 16  // two rings of eight, of equal areas
#define PS_CONE_PATCH 0.443113463  // width of what one of them stands for, over the light's radius: sqrt(pi / 16)
#define PS_CONE_INWARD 0.966733  // so that points and patches together are spread as the disk is: sqrt(1 - 4 / 12 * pi / 16)

// Means of the cone over the light's disk: plain, and weighted with n.l.
vec2 ps_cone_means(PsCone cone, vec3 ray, float radius, vec3 normal)
{
  // Aligned with the cone, so that the camera's turning changes nothing.
  float inverse = inversesqrt(max(dot(ray, ray), 1e-24));
  vec3 to_light = -ray * inverse;
  bool aside = abs(dot(to_light, cone.direction)) < 0.999;
  vec3 side_u = normalize(cross(aside ? cone.direction : cone.axis_u.xyz, to_light));
  vec3 side_v = cross(to_light, side_u);
  float step = abs(radius), stretched = max(length(cone.axis_u.xyz), length(cone.axis_v.xyz));
  float blurred = PS_CONE_PATCH * step * inverse * stretched;
  int count = radius == 0.0 ? 1 : PS_CONE_POINTS;
  vec2 azimuth = vec2(1.0, 0.0), total = vec2(0.0), weights = vec2(0.0);
  for (int i = 0; i < count; i++) {
    float away = step * PS_CONE_INWARD * (i < PS_CONE_POINTS / 2 ? 0.5 : 0.866025404);
    vec3 from_point = ray - away * (azimuth.x * side_u + azimuth.y * side_v);
    vec2 weight = vec2(1.0, max(-dot(from_point, normal), 0.0));
    total += ps_cone(cone, from_point, blurred) * weight;
    weights += weight;
    // By an eighth of a turn; the outer ring begins half of that later.
    azimuth = vec2(azimuth.x - azimuth.y, azimuth.x + azimuth.y) * 0.707106781;
    azimuth = i + 1 == PS_CONE_POINTS / 2 ? vec2(0.923879533, 0.382683432) : azimuth;
  }
  float plain = total.x / weights.x;
  return vec2(plain, weights.y > 0.0 ? total.y / weights.y : plain);
}

#endif

vec3 ps_spot(int index, vec3 position, PsLobes lobes)
{
  vec4 color = ps_light(index, 0), light_position = ps_light(index, 1);
  float radius = ps_light(index, 2).w;
  PsCone cone = ps_cone_of(index);
  PsReceived received = ps_local_light(lobes, light_position.xyz - position, radius);
#ifdef PS_HAS_WIDE_LIGHTS
  vec2 share = ps_cone_means(cone, position - light_position.xyz, radius, lobes.normal);
#else
  vec2 share = vec2(ps_cone(cone, position - light_position.xyz, 0.0));
#endif
  received.specular *= share.x;
  received.irradiance *= share.y;
  return ps_reflected(received, lobes, color, light_position.w);
}

#endif

#endif
