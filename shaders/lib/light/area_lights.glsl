// Rectangles and ellipses that shine to one side. For lights.glsl.

#ifdef PS_HAS_AREA_LIGHTS

// Solid angle, the sum of two triangles' (Van Oosterom and Strackee 1983): angles add as complex numbers multiply.
float ps_rectangle_solid_angle(PsArea area)
{
  vec3 a = normalize(area.offset - area.axis_u - area.axis_v), b = normalize(area.offset + area.axis_u - area.axis_v);
  vec3 c = normalize(area.offset + area.axis_u + area.axis_v), d = normalize(area.offset - area.axis_u + area.axis_v);
  float ac = dot(a, c);
  vec3 diagonal = cross(c, a);
  vec2 first = vec2(1.0 + dot(a, b) + dot(b, c) + ac, abs(dot(b, diagonal)));
  vec2 second = vec2(1.0 + ac + dot(c, d) + dot(d, a), abs(dot(d, diagonal)));
  return 2.0 * atan(first.x * second.y + first.y * second.x, first.x * second.x - first.y * second.y);
}

// Share of a GGX lobe centred on `at` in the square from -1 to 1.
float ps_rectangle_share(vec2 at, vec2 width)
{
  vec2 excess = (abs(at) - 1.0) / width;
  bool vertical = excess.y > excess.x;
  float flare = ps_flare(vertical ? excess.y : excess.x);
  width *= vertical ? vec2(flare, 1.0) : vec2(1.0, flare);
  vec2 low = (1.0 - at) / width, high = (1.0 + at) / width;
  return 0.25 * (ps_marginal(low.x) + ps_marginal(high.x)) * (ps_marginal(low.y) + ps_marginal(high.y));
}

#define PS_HALF_SIDES 12  // of the polygon that stands for an ellipse; a rectangle has 8, with the middles of its sides
#define PS_BEYOND 1.0  // widths of the lobe beyond the light, from where on half vectors are integrated
#define PS_MOST_OF_LOBE 1.25  // of what a lobe reflects at the mirrored ray, what it reflects in all

// The half vector between the eye and a point of the light, its component along the normal times alpha: among such vectors a GGX
// lobe is that of a Lambertian surface (Heitz et al. 2016).
vec3 ps_lambertian_half(vec3 to_point, PsLobes lobes)
{
  vec3 half_vector = to_point * inversesqrt(max(dot(to_point, to_point), 1e-20)) + lobes.to_eye;
#ifdef PS_TANGENT
  // Alphas along and across the grain are as one, and that of the normal its mean.
  half_vector += dot(half_vector, lobes.grain) * (1.0 / lobes.stretch - 1.0) * lobes.grain;
  vec3 across = cross(lobes.reflecting, lobes.grain);
  half_vector += dot(half_vector, across) * (lobes.stretch - 1.0) * across;
#endif
  return half_vector - (1.0 - lobes.alpha) * dot(half_vector, lobes.reflecting) * lobes.reflecting;
}

// Share of the lobe's half vectors that mirror the eye to the light. Its outline is curved there: points of its sides count too.
float ps_half_vector_share(PsArea area, bool ellipse, PsLobes lobes)
{
  const float angle = 2.0 * PS_PI / float(PS_HALF_SIDES);
  float sine = ellipse ? sin(angle) : sqrt(0.5), cosine = ellipse ? cos(angle) : sqrt(0.5);
  float size = ellipse ? sqrt(angle / sin(angle)) : 1.0, total = 0.0;
  vec2 at = vec2(1.0, 0.0);
  vec3 a = ps_lambertian_half(area.offset + size * area.axis_u, lobes);
  int sides = ellipse ? PS_HALF_SIDES : 8;
  for (int i = 0; i < sides; i++) {
    at = vec2(cosine * at.x - sine * at.y, sine * at.x + cosine * at.y);
    vec2 to = at * (ellipse ? size : 1.0 / max(abs(at.x), abs(at.y)));
    vec3 b = ps_lambertian_half(area.offset + to.x * area.axis_u + to.y * area.axis_v, lobes);
    total += ps_edge(a, b, lobes.reflecting);
    a = b;
  }
  return 0.5 * abs(total) / PS_PI;
}

// Integral of BSDF times n.l over the light for a narrow lobe. Where the mirrored ray meets the light or its plane near it: the
// share of the lobe that the light fills there. Beyond: the share of half vectors, by what else varies, at the nearest point. The
// table knows better what the whole lobe reflects, but where the eye is low not for one side of it alone.
vec3 ps_narrow_specular(PsArea area, float height, bool ellipse, PsLobes lobes)
{
  vec3 unit_u = area.axis_u / area.extent.x, unit_v = area.axis_v / area.extent.y;
  float ray = height / max(-dot(lobes.mirror, area.direction), 1e-4);
  vec3 meets = ray * lobes.mirror - area.offset;
  vec2 at = vec2(dot(meets, unit_u), dot(meets, unit_v)) / area.extent, nearest;
  vec2 width = vec2(ps_width_along(lobes, unit_u), ps_width_along(lobes, unit_v)) * ray / area.extent;
  float share, beyond;
  if (ellipse) {
    float radius = length(at);
    vec2 azimuth = radius > 0.0 ? at / max(radius, 1e-9) : vec2(1.0, 0.0);
    float along = length(azimuth * width);
    share = ps_disk_share(radius, 1.0, along, length(azimuth.yx * width));
    beyond = (radius - 1.0) / along;
    nearest = at / max(radius, 1.0);
  }
  else {
    share = ps_rectangle_share(at, width);
    vec2 excess = (abs(at) - 1.0) / width;
    beyond = max(excess.x, excess.y);
    nearest = clamp(at, -1.0, 1.0);
  }
  vec3 near = lobes.reflectance * (share * ps_beam(area, -dot(lobes.mirror, area.direction)));

  vec3 direction = normalize(area.offset + nearest.x * area.axis_u + nearest.y * area.axis_v);
  vec3 whole = min(lobes.reflectance / max(ps_half_weight(lobes, lobes.mirror), vec3(1e-9)), vec3(PS_MOST_OF_LOBE));
  float of_halves = ps_half_vector_share(area, ellipse, lobes) * ps_beam(area, -dot(direction, area.direction));
  return mix(near, of_halves * whole * ps_half_weight(lobes, direction), smoothstep(0.0, PS_BEYOND, beyond));
}

// Position in half-sides, and weight, of the quadrature of degree 5 over the square (Radon 1948), by the azimuths of
// the disk's points.
vec3 ps_square_point(vec2 azimuth)
{
  bool middle = abs(azimuth.x) > 0.75;  // of a side; the others have (0.6, 1/3) squared
  float weight = azimuth == vec2(0.0) ? 2.0 / 7.0 : middle ? 5.0 / 63.0 : 5.0 / 36.0;
  return vec3(azimuth.yx * vec2(0.894427191, middle ? 0.966091783 : 1.154700538), weight);
}

// Mean of BSDF times n.l over the light, by the centre and six points, which weigh with the solid angle around them.
vec3 ps_area_specular(PsArea area, int count, bool ellipse, float a2, PsLobes lobes)
{
  vec2 azimuth = vec2(0.0);
  float weights = 0.0;
  vec3 sum = vec3(0.0);
  for (int i = 0; i < count; i++) {
    vec3 point = ellipse ? vec3(PS_DISK_RADIUS * azimuth, i == 0 ? 0.25 : 0.125) : ps_square_point(azimuth);
    vec3 to_point = area.offset + point.x * area.axis_u + point.y * area.axis_v;
    float inverse = inversesqrt(max(dot(to_point, to_point), 1e-20));
    float weight = point.z * inverse * inverse * inverse;
    vec3 direction = to_point * inverse;
    sum += weight * ps_beam(area, -dot(direction, area.direction)) * ps_specular(lobes, direction, a2);
    weights += weight;
    azimuth = ps_next_azimuth(azimuth);
  }
  return sum / weights;
}

#ifdef PS_TANGENT
#define PS_FINE_SIDE 8  // points along each side of the light
#define PS_FINE_BLUR 0.004  // as PS_BLUR, of one of them

// As ps_area_specular, by so many points that a lobe which is narrow in one direction does not pass between them.
vec3 ps_area_stretched(PsArea area, int count, bool ellipse, float sigma, PsLobes lobes)
{
  float weights = 0.0, a2 = min(lobes.alpha * lobes.alpha + PS_FINE_BLUR * sigma * sigma, 1.0);
  vec3 sum = vec3(0.0);
  for (int i = 0; i < count; i++) {
    vec2 at = (vec2(i % PS_FINE_SIDE, i / PS_FINE_SIDE) + 0.5) * (2.0 / float(PS_FINE_SIDE)) - 1.0;
    float chord = ellipse ? sqrt(1.0 - at.x * at.x) : 1.0;
    vec3 to_point = area.offset + at.x * area.axis_u + chord * at.y * area.axis_v;
    float inverse = inversesqrt(max(dot(to_point, to_point), 1e-20));
    float weight = chord * inverse * inverse * inverse;
    vec3 direction = to_point * inverse;
    sum += weight * ps_beam(area, -dot(direction, area.direction)) * ps_specular(lobes, direction, a2);
    weights += weight;
  }
  return sum / max(weights, 1e-30);
}
#endif

#ifdef PS_DIFFUSE_LOBES

// Mean of the diffuse lobes' BSDF over the light, times pi, by the same points, which weigh with their irradiance.
vec3 ps_area_shaped(PsArea area, bool ellipse, PsLobes lobes)
{
  vec2 azimuth = vec2(0.0);
  float weights = 0.0;
  vec3 sum = vec3(0.0);
  for (int i = 0; i < 7; i++) {
    vec3 point = ellipse ? vec3(PS_DISK_RADIUS * azimuth, i == 0 ? 0.25 : 0.125) : ps_square_point(azimuth);
    vec3 to_point = area.offset + point.x * area.axis_u + point.y * area.axis_v;
    float inverse = inversesqrt(max(dot(to_point, to_point), 1e-20));
    vec3 direction = to_point * inverse;
    float weight = point.z * inverse * inverse * inverse * ps_beam(area, -dot(direction, area.direction));
    weight *= max(dot(direction, lobes.normal), 1e-6);
    sum += weight * ps_shaped(lobes, direction);
    weights += weight;
    azimuth = ps_next_azimuth(azimuth);
  }
  return sum / max(weights, 1e-30);
}

#endif

// `ellipse` is a constant where this is called.
vec3 ps_area_light(int index, bool ellipse, vec3 position, PsLobes lobes)
{
  vec4 color = ps_light(index, 0), light_position = ps_light(index, 1);
  PsArea area = ps_area(index, light_position.xyz - position);
  float height = max(-dot(area.offset, area.direction), 1e-9);
  float irradiance = ellipse ? ps_ellipse_irradiance(area, lobes.normal) : ps_rectangle_irradiance(area, lobes.normal);
#ifdef PS_HAS_BEAMS
  float narrowed = ps_beam_irradiance(area, height, ellipse, lobes.normal);
  irradiance = area.beam == 0.0 ? irradiance : narrowed;
#endif

  // Wide lobes: points of the light; narrow ones: the share of the lobe that the light fills.
  float solid_angle = ps_rectangle_solid_angle(area) * (ellipse ? PS_PI / 4.0 : 1.0);
  float sigma = sqrt(solid_angle / PS_PI);
  float narrow = smoothstep(PS_AREA_NARROW_LOW, PS_AREA_NARROW_HIGH, sigma / (sqrt(2.0) * lobes.alpha));
#ifdef PS_TANGENT
  bool fine = lobes.stretch > 1.0;
  float least = lobes.alpha / lobes.stretch * float(PS_FINE_SIDE) * 0.5;
  narrow = fine ? smoothstep(PS_AREA_NARROW_LOW, PS_AREA_NARROW_HIGH, sigma / (sqrt(2.0) * least)) : narrow;
#endif
  int count = ps_is_small(lobes, sigma) || narrow == 1.0 ? 1 : 7;
  vec3 wide = solid_angle * ps_area_specular(area, count, ellipse, ps_widened_alpha2(lobes, sigma), lobes);
#ifdef PS_TANGENT
  vec3 stretched = ps_area_stretched(area, fine ? PS_FINE_SIDE * PS_FINE_SIDE : 0, ellipse, sigma, lobes);
  wide = fine ? solid_angle * stretched : wide;
#endif
  vec3 specular = mix(wide, ps_narrow_specular(area, height, ellipse, lobes), narrow);
#ifdef PS_DIFFUSE_LOBES
  PsReceived received = PsReceived(irradiance, specular, ps_area_shaped(area, ellipse, lobes));
#else
  PsReceived received = PsReceived(irradiance, specular);
#endif
  vec3 reflected = ps_reflected(received, lobes, color, light_position.w);
  // Half a sphere of light comes to what lies in front of it, nothing to what lies in its plane, but for rounding.
  vec3 apart = light_position.xyz - position;
  float rounding = 1e-6 * (length(position) + length(light_position.xyz));
  return dot(apart, area.direction) < -rounding ? reflected : vec3(0.0);
}

#endif
