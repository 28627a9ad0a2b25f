// Direct light in view space; the entry is ps_shade. Reference, sources and the layout of ps_lights: core/light/lighting.py.
// Names say what a scene needs, and all else is left out: PS_HAS_SUNS, PS_HAS_POINTS, PS_HAS_SPOTS, PS_HAS_RECTANGLES,
// PS_HAS_ELLIPSES (kinds of lights), PS_ONE_KIND (all lights are of one); PS_HAS_WIDE_LIGHTS (some light's size is
// seen), PS_HAS_BEAMS (narrowed area lights), PS_HAS_METAL, PS_ONE_SURFACE, PS_HAS_WORLD, PS_HAS_ENVIRONMENT. Some
// devices run both sides of every branch, so work that not all pixels need stands in loops of as many turns as a
// pixel needs.

#if defined(PS_HAS_SUNS) || defined(PS_HAS_POINTS) || defined(PS_HAS_SPOTS)
#define PS_HAS_ROUND_LIGHTS
#endif
#if defined(PS_HAS_RECTANGLES) || defined(PS_HAS_ELLIPSES)
#define PS_HAS_AREA_LIGHTS
#endif
#if defined(PS_HAS_ROUND_LIGHTS) || defined(PS_HAS_AREA_LIGHTS)
#define PS_HAS_LIGHTS
#endif

#include "lib/light/brdf.glsl"
#include "lib/light/environment.glsl"
#include "lib/shadow/shadow.glsl"

#define PS_FIRST_LIGHT (PS_TABLE_ROWS + 2)
#define PS_ELLIPSE_SIDES 24
#define PS_SPREAD_CELLS 8
#define PS_BLUR 0.06
#define PS_NARROW_LOW 1.5
#define PS_NARROW_HIGH 4.0
#define PS_SMALL 0.2  // of the lobe's alpha: the angular radius of a light that is a point to it

#ifdef PS_HAS_LIGHTS

// What one light does to one surface point, per unit of its colour.
struct PsReceived {
  float irradiance;
  vec3 specular;  // radiance of the GGX lobe
};

vec4 ps_light(int index, int column)
{
  return texelFetch(ps_lights, ivec2(column, PS_FIRST_LIGHT + index), 0);
}

// Radiance that the surface reflects; the light's colour and position texels hold its factors.
vec3 ps_reflected(PsReceived received, PsLobes lobes, vec4 color, float specular)
{
  return color.rgb * (color.w * received.irradiance / PS_PI * lobes.diffuse + specular * received.specular);
}

// The points of a quadrature of degree 5 over the unit disk: the centre, weighing 1/4, then six at this distance,
// weighing 1/8 each.
#define PS_DISK_RADIUS 0.816496581  // sqrt(2 / 3)

// The next of the six by its azimuth (cosine, sine); the centre has none.
vec2 ps_next_azimuth(vec2 azimuth)
{
  const float sine = 0.866025404;
  vec2 turned = vec2(0.5 * azimuth.x - sine * azimuth.y, sine * azimuth.x + 0.5 * azimuth.y);
  return azimuth == vec2(0.0) ? vec2(1.0, 0.0) : turned;
}

// Share of a GGX lobe's half vectors with a slope of at most x alpha to either side in one direction, odd in x.
float ps_marginal(float x)
{
  return x * inversesqrt(1.0 + x * x);
}

// How much wider the lobe is across where it is x alpha off in one direction: its tails fan out.
float ps_flare(float x)
{
  x = max(x, 0.0);
  return sqrt(1.0 + x * x);
}

// Share of a GGX lobe in a disk of radius sigma whose centre is `angle` away, as for a square of that height.
float ps_disk_share(float angle, float sigma, float width, float width_across)
{
  float along = ps_marginal((sigma - angle) / width) + ps_marginal((sigma + angle) / width);
  return 0.5 * along * ps_marginal(sigma / (width_across * ps_flare((angle - sigma) / width)));
}

// 0: the lobe is wide against a light of angular radius sigma; 1: narrow.
float ps_narrow(PsLobes lobes, float sigma)
{
  return smoothstep(PS_NARROW_LOW, PS_NARROW_HIGH, sigma / (sqrt(2.0) * lobes.alpha));
}

bool ps_is_small(PsLobes lobes, float sigma)
{
  return sigma < PS_SMALL * lobes.alpha;
}

// alpha^2 of the lobe, blurred by the part of the light that each point of a quadrature stands for.
float ps_blurred(PsLobes lobes, float sigma)
{
  float a2 = lobes.alpha * lobes.alpha;
  return ps_is_small(lobes, sigma) ? a2 : min(a2 + PS_BLUR * sigma * sigma, 1.0);
}

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
  float a2 = ps_blurred(lobes, sigma);
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

// A light that fills a cone around to_light, of which sine2 is the squared sine of half the angle. scale: irradiance
// of a surface that faces it.
PsReceived ps_round_light(PsLobes lobes, vec3 to_light, float sine2, float scale)
{
#ifdef PS_HAS_WIDE_LIGHTS
  float cosine = sqrt(max(1.0 - sine2, 0.0));
  float energy = scale * 2.0 / (1.0 + cosine);
  return PsReceived(scale * ps_cap_cosine(dot(lobes.normal, to_light), sine2),
                    energy * ps_cone_specular(lobes, to_light, sine2, cosine));
#else
  return PsReceived(scale * max(dot(lobes.normal, to_light), 0.0),
                    scale * ps_specular(lobes, to_light, lobes.alpha * lobes.alpha));
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
PsReceived ps_lamp(PsLobes lobes, vec3 offset, float radius)
{
  float d2 = max(dot(offset, offset), 1e-24);
  vec3 to_light = offset * inversesqrt(d2);
#ifdef PS_HAS_WIDE_LIGHTS
  float r2 = radius * radius;
  float reach2 = radius < 0.0 ? max(d2, r2) : d2 + r2;
  PsReceived received = ps_round_light(lobes, to_light, r2 / reach2, 1.0 / reach2);
  // Inside a sphere light comes from everywhere.
  received.irradiance = radius < 0.0 && d2 < r2 ? 1.0 / reach2 : received.irradiance;
  return received;
#else
  return ps_round_light(lobes, to_light, 0.0, 1.0 / d2);
#endif
}

vec3 ps_point(int index, vec3 position, PsLobes lobes)
{
  vec4 color = ps_light(index, 0), place = ps_light(index, 1);
#ifdef PS_HAS_WIDE_LIGHTS
  float radius = ps_light(index, 2).w;
#else
  float radius = 0.0;
#endif
  return ps_reflected(ps_lamp(lobes, place.xyz - position, radius), lobes, color, place.w);
}

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
  vec4 color = ps_light(index, 0), place = ps_light(index, 1), direction = ps_light(index, 2);
  PsCone cone = PsCone(direction.xyz, ps_light(index, 3), ps_light(index, 4));
  PsReceived received = ps_lamp(lobes, place.xyz - position, direction.w);
#ifdef PS_HAS_WIDE_LIGHTS
  vec2 share = ps_cone_means(cone, position - place.xyz, direction.w, lobes.normal);
#else
  vec2 share = vec2(ps_cone(cone, position - place.xyz));
#endif
  received.specular *= share.x;
  received.irradiance *= share.y;
  return ps_reflected(received, lobes, color, place.w);
}

#endif

#endif

#ifdef PS_HAS_AREA_LIGHTS

// Lengths in units of the largest of them: what an area sends depends on angles alone, and the fourth powers of
// lengths below 1e-9 or above 1e9 are no floats.
struct PsArea {
  vec3 offset;  // from the surface to the middle
  vec3 direction;
  vec3 axis_u;
  vec3 axis_v;
  vec2 extent;  // lengths of the axes
  float limit;  // tangent of half the beam's angle
  float beam;  // 1 / mean of the beam over the flux; 0: not narrowed
};

PsArea ps_area(int index, vec3 offset)
{
  vec4 direction = ps_light(index, 2), axis_u = ps_light(index, 3), axis_v = ps_light(index, 4);
#ifdef PS_HAS_BEAMS
  float limit = ps_light(index, 5).x;
#else
  float limit = 0.0;
#endif
  vec3 apart = abs(offset);
  float unit = 1.0 / max(max(max(apart.x, apart.y), apart.z), max(axis_u.w, axis_v.w));
  return PsArea(offset * unit, direction.xyz, axis_u.xyz * unit, axis_v.xyz * unit,
                vec2(axis_u.w, axis_v.w) * unit, limit, direction.w);
}

// Twice what the edge from a to b adds to Lambert's formula: the angle between them times the component along the
// normal of the unit vector perpendicular to both.
float ps_edge(vec3 a, vec3 b, vec3 normal)
{
  float scale = inversesqrt(max(dot(a, a) * dot(b, b), 1e-30));
  float cosine = clamp(dot(a, b) * scale, -1.0, 1.0);
  // angle / sine for an acute angle: a rational fit, exact to 6e-7.
  float x = abs(cosine);
  float acute = (1.570795 + (0.9058155 + 0.02603237 * x) * x) / (1.0 + (1.21324 + 0.2894018 * x) * x);
  float ratio = cosine < 0.0 ? PS_PI * inversesqrt(max(1.0 - x * x, 1e-12)) - acute : acute;
  return ratio * scale * dot(cross(a, b), normal);
}

// Lambert's formula, cut by the horizon: a convex polygon leaves and enters the upper side at most once.
struct PsPolygon {
  float total;
  vec3 leaving;
  vec3 entering;
};

void ps_add_edge(inout PsPolygon polygon, vec3 a, vec3 b, vec3 normal)
{
  float above = dot(a, normal), below = dot(b, normal);
  float gap = above - below;
  vec3 crossing = mix(a, b, clamp(above / (gap == 0.0 ? 1.0 : gap), 0.0, 1.0));
  bool enters = above <= 0.0 && below > 0.0, leaves = above > 0.0 && below <= 0.0;
  polygon.entering = enters ? crossing : polygon.entering;
  polygon.leaving = leaves ? crossing : polygon.leaving;
  float edge = ps_edge(enters ? crossing : a, leaves ? crossing : b, normal);
  polygon.total += above > 0.0 || below > 0.0 ? edge : 0.0;
}

float ps_polygon_irradiance(PsPolygon polygon, vec3 normal)
{
  return 0.5 * abs(polygon.total + ps_edge(polygon.leaving, polygon.entering, normal));
}

float ps_rectangle_irradiance(PsArea area, vec3 normal)
{
  vec3 a = area.offset - area.axis_u - area.axis_v, b = area.offset + area.axis_u - area.axis_v;
  vec3 c = area.offset + area.axis_u + area.axis_v, d = area.offset - area.axis_u + area.axis_v;
  PsPolygon polygon = PsPolygon(0.0, vec3(0.0), vec3(0.0));
  ps_add_edge(polygon, a, b, normal);
  ps_add_edge(polygon, b, c, normal);
  ps_add_edge(polygon, c, d, normal);
  ps_add_edge(polygon, d, a, normal);
  return ps_polygon_irradiance(polygon, normal);
}

// As a polygon of the ellipse's area.
float ps_ellipse_irradiance(PsArea area, vec3 normal)
{
  const float angle = 2.0 * PS_PI / float(PS_ELLIPSE_SIDES);
  float sine = sin(angle), cosine = cos(angle);
  vec2 place = vec2(sqrt(angle / sine), 0.0);
  vec3 a = area.offset + place.x * area.axis_u;
  PsPolygon polygon = PsPolygon(0.0, vec3(0.0), vec3(0.0));
  for (int i = 0; i < PS_ELLIPSE_SIDES; i++) {
    place = vec2(cosine * place.x - sine * place.y, sine * place.x + cosine * place.y);
    vec3 b = area.offset + place.x * area.axis_u + place.y * area.axis_v;
    ps_add_edge(polygon, a, b, normal);
    a = b;
  }
  return ps_polygon_irradiance(polygon, normal);
}

// The share of an area light's radiance that leaves it at an angle from its normal: Blender's soft-box grid.
float ps_beam(PsArea area, float cosine)
{
#ifdef PS_HAS_BEAMS
  float tangent = sqrt(max(1.0 - cosine * cosine, 0.0)) / max(cosine, 1e-6);
  return area.beam == 0.0 ? 1.0 : max(area.limit - tangent, 0.0) * area.beam;
#else
  return 1.0;
#endif
}

#ifdef PS_HAS_BEAMS

// A light whose beam is narrowed: a grid over the part that can shine here.
float ps_beam_irradiance(PsArea area, float height, bool ellipse, vec3 normal)
{
  vec3 unit_u = area.axis_u / area.extent.x, unit_v = area.axis_v / area.extent.y;
  vec2 foot = -vec2(dot(area.offset, unit_u), dot(area.offset, unit_v));
  float reach = height * area.limit;
  vec2 low = max(foot - reach, -area.extent), high = min(foot + reach, area.extent);
  vec2 size = max(high - low, 0.0) / float(PS_SPREAD_CELLS);
  int rows = area.beam == 0.0 || size.x * size.y == 0.0 ? 0 : PS_SPREAD_CELLS;
  float total = 0.0;
  for (int row = 0; row < rows; row++) {
    vec2 place = low + size * vec2(0.5, float(row) + 0.5);
    for (int column = 0; column < PS_SPREAD_CELLS; column++) {
      vec2 relative = place / area.extent;
      vec3 to_light = area.offset + place.x * unit_u + place.y * unit_v;
      float inverse = inversesqrt(dot(to_light, to_light));
      float cosine = max(dot(to_light, normal), 0.0) * inverse;
      float part = ps_beam(area, height * inverse) * cosine * height * inverse * inverse * inverse;
      total += ellipse && dot(relative, relative) > 1.0 ? 0.0 : part;
      place.x += size.x;
    }
  }
  return total * size.x * size.y;
}

#endif

// Of two triangles (Van Oosterom and Strackee 1983), whose angles add as those of complex numbers do.
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

// Share of a GGX lobe centred on `place` in the square from -1 to 1.
float ps_rectangle_share(vec2 place, vec2 width)
{
  vec2 excess = (abs(place) - 1.0) / width;
  bool vertical = excess.y > excess.x;
  float flare = ps_flare(vertical ? excess.y : excess.x);
  width *= vertical ? vec2(flare, 1.0) : vec2(1.0, flare);
  vec2 low = (1.0 - place) / width, high = (1.0 + place) / width;
  return 0.25 * (ps_marginal(low.x) + ps_marginal(high.x)) * (ps_marginal(low.y) + ps_marginal(high.y));
}

// Share of the lobe that the light fills, where the mirrored ray meets the light's plane.
float ps_area_share(PsArea area, float height, bool ellipse, PsLobes lobes)
{
  vec3 unit_u = area.axis_u / area.extent.x, unit_v = area.axis_v / area.extent.y;
  float ray = height / max(-dot(lobes.mirror, area.direction), 1e-4);
  vec3 meets = ray * lobes.mirror - area.offset;
  vec2 place = vec2(dot(meets, unit_u), dot(meets, unit_v)) / area.extent;
  vec2 width = vec2(ps_width_along(lobes, unit_u), ps_width_along(lobes, unit_v)) * ray / area.extent;
  float share;
  if (ellipse) {
    float radius = length(place);
    vec2 azimuth = radius > 0.0 ? place / max(radius, 1e-9) : vec2(1.0, 0.0);
    share = ps_disk_share(radius, 1.0, length(azimuth * width), length(azimuth.yx * width));
  }
  else {
    share = ps_rectangle_share(place, width);
  }
  return share * ps_beam(area, -dot(lobes.mirror, area.direction));
}

// Place in half-sides, and weight, of the quadrature of degree 5 over the square (Radon 1948), by the azimuths of the
// disk's points.
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
    vec3 place = ellipse ? vec3(PS_DISK_RADIUS * azimuth, i == 0 ? 0.25 : 0.125) : ps_square_point(azimuth);
    vec3 to_point = area.offset + place.x * area.axis_u + place.y * area.axis_v;
    float inverse = inversesqrt(max(dot(to_point, to_point), 1e-20));
    float weight = place.z * inverse * inverse * inverse;
    vec3 direction = to_point * inverse;
    sum += weight * ps_beam(area, -dot(direction, area.direction)) * ps_specular(lobes, direction, a2);
    weights += weight;
    azimuth = ps_next_azimuth(azimuth);
  }
  return sum / weights;
}

// `ellipse` is a constant where this is called.
vec3 ps_area_light(int index, bool ellipse, vec3 position, PsLobes lobes)
{
  vec4 color = ps_light(index, 0), place = ps_light(index, 1);
  PsArea area = ps_area(index, place.xyz - position);
  float height = max(-dot(area.offset, area.direction), 1e-9);
  float irradiance = ellipse ? ps_ellipse_irradiance(area, lobes.normal) : ps_rectangle_irradiance(area, lobes.normal);
#ifdef PS_HAS_BEAMS
  float narrowed = ps_beam_irradiance(area, height, ellipse, lobes.normal);
  irradiance = area.beam == 0.0 ? irradiance : narrowed;
#endif

  // Wide lobes: points of the light; narrow ones: the share of the lobe that the light fills.
  float solid_angle = ps_rectangle_solid_angle(area) * (ellipse ? PS_PI / 4.0 : 1.0);
  float sigma = sqrt(solid_angle / PS_PI);
  float narrow = ps_narrow(lobes, sigma);
  int count = ps_is_small(lobes, sigma) || narrow == 1.0 ? 1 : 7;
  vec3 wide = solid_angle * ps_area_specular(area, count, ellipse, ps_blurred(lobes, sigma), lobes);
  vec3 specular = mix(wide, lobes.reflectance * ps_area_share(area, height, ellipse, lobes), narrow);
  vec3 reflected = ps_reflected(PsReceived(irradiance, specular), lobes, color, place.w);
  return dot(area.offset, area.direction) < 0.0 ? reflected : vec3(0.0);
}

#endif

// Rows of lights are sorted by kind; each kind but the last ends where this says.
ivec4 ps_light_ends()
{
  return ivec4(texelFetch(ps_lights, ivec2(4, PS_WORLD_ROW), 0) + 0.5);
}

// What of the light that lamp `index` sends reaches a point in view space, whose normal is 0 within a medium.
#ifdef PS_REACHED
vec3 ps_reached[4];  // known before
#endif

vec3 ps_reaching(int index, vec3 light, vec3 position, vec3 normal)
{
#if defined(PS_REACHED)
  return light * ps_reached[index];
#elif defined(PS_SHADOWS)
  return light * ps_transmittance(index, position, normal, any(greaterThan(light, vec3(0.0))));
#else
  return light;
#endif
}

vec3 ps_shade_lights(vec3 position, PsLobes lobes, int light_count)
{
  vec3 result = vec3(0.0);
  int i = 0;
#ifdef PS_ONE_KIND
  ivec4 ends = ivec4(light_count);
#else
  ivec4 ends = ps_light_ends();
#endif
#ifdef PS_HAS_SUNS
  for (; i < ends.x; i++) {
    result += ps_reaching(i, ps_sun(i, lobes), position, lobes.normal);
  }
#endif
#ifdef PS_HAS_POINTS
  for (; i < ends.y; i++) {
    result += ps_reaching(i, ps_point(i, position, lobes), position, lobes.normal);
  }
#endif
#ifdef PS_HAS_SPOTS
  for (; i < ends.z; i++) {
    result += ps_reaching(i, ps_spot(i, position, lobes), position, lobes.normal);
  }
#endif
#ifdef PS_HAS_RECTANGLES
  for (; i < ends.w; i++) {
    result += ps_reaching(i, ps_area_light(i, false, position, lobes), position, lobes.normal);
  }
#endif
#ifdef PS_HAS_ELLIPSES
  for (; i < light_count; i++) {
    result += ps_reaching(i, ps_area_light(i, true, position, lobes), position, lobes.normal);
  }
#endif
  return result;
}

// Henyey and Greenstein 1941; `cosine` of the angle by which light turns.
float ps_phase(float g, float cosine)
{
  float base = max(1.0 + g * g - 2.0 * g * cosine, 1e-6);
  return (1.0 - g * g) / (4.0 * PS_PI * base * sqrt(base));
}

// Irradiance of a small ball, over its cross-section, by one light; to_light points at the light's middle.
vec3 ps_ball_irradiance(int index, ivec4 ends, vec3 position, out vec3 to_light)
{
  vec4 color = ps_light(index, 0), place = ps_light(index, 1), direction = ps_light(index, 2);
  to_light = place.xyz;
  if (index < ends.x) {
    return color.rgb;
  }
  vec3 offset = place.xyz - position;
  float d2 = max(dot(offset, offset), 1e-24);
  to_light = offset * inversesqrt(d2);
  float share = 1.0 / (direction.w > 0.0 ? d2 + direction.w * direction.w : max(d2, direction.w * direction.w));
#ifdef PS_HAS_SPOTS
  if (index >= ends.y && index < ends.z) {
    share *= ps_cone(PsCone(direction.xyz, ps_light(index, 3), ps_light(index, 4)), -offset);
  }
#endif
#ifdef PS_HAS_AREA_LIGHTS
  if (index >= ends.z) {
    PsArea area = ps_area(index, offset);
    share = ps_rectangle_solid_angle(area) * (index < ends.w ? 1.0 : PS_PI / 4.0);
    float facing = -dot(to_light, area.direction);
    share *= facing > 0.0 ? ps_beam(area, facing) : 0.0;
  }
#endif
  return color.rgb * share;
}

#endif

// The mean radiance of the world.
vec3 ps_ambient()
{
#if defined(PS_HAS_ENVIRONMENT)
  // Irradiances from both sides, over pi, make the mean along each axis.
  vec3 sum = vec3(0.0);
  for (int i = 0; i < 6; i++) {
    vec3 axis = (i % 2 == 0 ? 1.0 : -1.0) * vec3(equal(ivec3(i / 2), ivec3(0, 1, 2)));
    sum += ps_environment_level(ps_uv_from_direction(axis), PS_ROUGH_LEVELS + 1);
  }
  return sum / 6.0;
#elif defined(PS_HAS_WORLD)
  return texelFetch(ps_lights, ivec2(0, PS_WORLD_ROW), 0).rgb;
#else
  return vec3(0.0);
#endif
}

// Light that a medium of this albedo scatters once towards the eye, over its extinction; g is Henyey and Greenstein's.
vec3 ps_shade_medium(vec3 position, vec3 to_eye, float g, vec3 albedo, int light_count)
{
  vec3 result = ps_ambient();
#ifdef PS_HAS_LIGHTS
  ivec4 ends = ps_light_ends();
  for (int i = 0; i < light_count; i++) {
    vec3 to_light;
    vec3 irradiance = ps_ball_irradiance(i, ends, position, to_light);
    irradiance = ps_reaching(i, irradiance, position, vec3(0.0));
    result += irradiance * ps_phase(g, -dot(to_light, to_eye));
  }
#endif
  return albedo * result;
}

// Radiance towards the eye at a point in view space. normal and to_eye are unit; the surface is two-sided: the normal
// is turned to the viewer. light_count: how many rows of lights ps_lights holds.
vec3 ps_shade(vec3 position, vec3 normal, vec3 to_eye, PsSurface surface, int light_count)
{
  vec3 result = surface.emission;
#if defined(PS_HAS_LIGHTS) || defined(PS_HAS_WORLD) || defined(PS_HAS_ENVIRONMENT)
  normal = dot(normal, to_eye) < 0.0 ? -normal : normal;
  PsLobes lobes = ps_lobes(surface, normal, to_eye);
#ifdef PS_HAS_LIGHTS
  result += ps_shade_lights(position, lobes, light_count);
#endif
  result += ps_shade_world(lobes);
#endif
  return result;
}
