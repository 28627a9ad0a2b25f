// Direct light in view space; the entry is ps_shade. Reference, sources and the layout of ps_lights: core/lighting.py.
// PS_HAS_LIGHTS, PS_HAS_AREA_LIGHTS, PS_HAS_WORLD, PS_HAS_ENVIRONMENT switch on what a scene needs.

#include "lib/brdf.glsl"
#include "lib/environment.glsl"

#define PS_FIRST_LIGHT (PS_TABLE_ROWS + 1)
#define PS_KIND_SPOT 1
#define PS_KIND_SUN 2
#define PS_KIND_AREA 3
#define PS_ELLIPSE_SIDES 24
#define PS_SPREAD_CELLS 8
#define PS_BLUR 0.06
#define PS_NARROW_LOW 1.5
#define PS_NARROW_HIGH 4.0
#define PS_SMALL 0.02  // of the lobe's width: a light that is a point to it

#ifdef PS_HAS_LIGHTS

struct PsLight {
  vec3 color;
  int kind;
  vec3 position;
  float radius;
  vec3 direction;
  float diffuse;
  vec3 axis_u;
  float specular;
  vec3 axis_v;
  vec3 shape;
};

// What one light does to one surface point, per unit of its colour.
struct PsReceived {
  float irradiance;
  vec3 specular;  // radiance of the GGX lobe
};

PsLight ps_light(int index)
{
  int row = PS_FIRST_LIGHT + index;
  vec4 color = texelFetch(ps_lights, ivec2(0, row), 0);
  vec4 position = texelFetch(ps_lights, ivec2(1, row), 0);
  vec4 direction = texelFetch(ps_lights, ivec2(2, row), 0);
  vec4 axis_u = texelFetch(ps_lights, ivec2(3, row), 0);
  vec3 axis_v = texelFetch(ps_lights, ivec2(4, row), 0).xyz;
  vec3 shape = texelFetch(ps_lights, ivec2(5, row), 0).xyz;
  return PsLight(color.xyz, int(color.w + 0.5), position.xyz, position.w, direction.xyz, direction.w, axis_u.xyz,
                 axis_u.w, axis_v, shape);
}

// A quadrature of degree 5 over the unit disk: place and weight of the centre and six points.
vec3 ps_disk_point(int i)
{
  float angle = float(i - 1) * PS_PI / 3.0;
  float radius = i == 0 ? 0.0 : sqrt(2.0 / 3.0);
  return vec3(radius * cos(angle), radius * sin(angle), i == 0 ? 0.25 : 0.125);
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

// Share of a GGX lobe centred on `place` in the square from -1 to 1.
float ps_rectangle_share(vec2 place, vec2 width)
{
  vec2 excess = (abs(place) - 1.0) / width;
  if (excess.y > excess.x) {
    width.x *= ps_flare(excess.y);
  }
  else {
    width.y *= ps_flare(excess.x);
  }
  vec2 low = (1.0 - place) / width, high = (1.0 + place) / width;
  return 0.25 * (ps_marginal(low.x) + ps_marginal(high.x)) * (ps_marginal(low.y) + ps_marginal(high.y));
}

// 0: the lobe is wide against a light of angular radius sigma; 1: narrow.
float ps_narrow(PsLobes lobes, float sigma)
{
  return smoothstep(PS_NARROW_LOW, PS_NARROW_HIGH, sigma / (sqrt(2.0) * lobes.alpha));
}

// The lobe blurred by the part of the light that each point of a quadrature stands for.
float ps_blurred_alpha(PsLobes lobes, float sigma)
{
  return min(sqrt(lobes.alpha * lobes.alpha + PS_BLUR * sigma * sigma), 1.0);
}

// Irradiance of a bright cone over that of the same cone overhead, cut by the horizon (Snyder 1996).
float ps_cap_cosine(float cosine, float sine2)
{
  sine2 = clamp(sine2, 0.0, 1.0);
  // Narrow cones change within a fraction of their own width only, and would cancel below.
  if (sine2 < 4e-6 || abs(cosine) >= sqrt(sine2)) {
    return max(cosine, 0.0);
  }
  float sin_theta = sqrt(max(1.0 - cosine * cosine, 1e-12));
  float x = sqrt(max(1.0 / sine2 - 1.0, 0.0));
  float y = clamp(-x * cosine / sin_theta, -1.0, 1.0);
  float up = sqrt(1.0 - y * y), chord = sin_theta * up;
  // atan throughout: some drivers' acos and asin are good to 1e-4 only.
  return max(cosine * atan(up, y) - x * chord + atan(chord, x) / sine2, 0.0) / PS_PI;
}

float ps_spot_cone(PsLight light, vec3 ray)
{
  vec3 local = vec3(dot(ray, light.axis_u), dot(ray, light.axis_v), dot(ray, light.direction));
  float z = local.z / max(length(local), 1e-20);
  float t = clamp((z - light.shape.y) / max((1.0 - light.shape.y) * light.shape.z, 1e-6), 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

// Means of the cone over the light's disk, by the centre and six points (a quadrature of degree 5): plain, and
// weighted with n.l.
vec2 ps_spot_factors(PsLight light, vec3 position, vec3 normal, vec3 to_light)
{
  vec3 ray = position - light.position;
  if (light.radius <= 0.0) {
    return vec2(ps_spot_cone(light, ray));
  }
  // Aligned with the cone, so that the camera's turning changes nothing.
  bool aside = abs(dot(to_light, light.direction)) < 0.999;
  vec3 u = normalize(cross(aside ? light.direction : light.axis_u, to_light));
  vec3 v = cross(to_light, u);
  float radius = light.radius * sqrt(2.0 / 3.0);
  vec2 total = vec2(0.0);
  float weights = 0.0;
  for (int i = 0; i < 7; i++) {
    vec3 point = ps_disk_point(i);
    vec3 from_point = ray - light.radius * (point.x * u + point.y * v);
    float weight = point.z * max(-dot(from_point, normal), 0.0);
    total += ps_spot_cone(light, from_point) * vec2(point.z, weight);
    weights += weight;
  }
  return vec2(total.x, weights > 0.0 ? total.y / weights : total.x);
}

PsReceived ps_round_light(PsLight light, vec3 position, vec3 normal, vec3 to_eye, PsLobes lobes)
{
  vec3 to_light = -light.direction;
  float sine2, strength = 1.0;
  vec2 cone = vec2(1.0);
  bool inside = false;
  if (light.kind == PS_KIND_SUN) {
    sine2 = sin(min(light.radius, 0.5 * PS_PI));
    sine2 *= sine2;
  }
  else {
    vec3 offset = light.position - position;
    float d2 = max(dot(offset, offset), 1e-20);
    to_light = offset * inversesqrt(d2);
    // A facing disk is seen as a cone, as a sphere is, only under a smaller angle.
    float r2 = light.radius * light.radius;
    float reach2 = light.shape.x < 0.5 ? d2 + r2 : max(d2, r2);
    sine2 = r2 / reach2;
    strength = 1.0 / reach2;
    inside = light.shape.x > 0.5 && d2 < r2;
    if (light.kind == PS_KIND_SPOT) {
      cone = ps_spot_factors(light, position, normal, to_light);
    }
  }
  float cosine = sqrt(max(1.0 - sine2, 0.0));
  float sigma = atan(sqrt(sine2), cosine);
  // Inside a sphere light comes from everywhere.
  float received = inside ? 1.0 : ps_cap_cosine(dot(normal, to_light), sine2);
  float irradiance = strength * cone.y * received;
  float energy = strength * cone.x * 2.0 / (1.0 + cosine);
  if (energy <= 0.0) {
    return PsReceived(irradiance, vec3(0.0));
  }
  if (sigma < PS_SMALL * lobes.alpha) {
    return PsReceived(irradiance, energy * ps_specular(lobes, normal, to_eye, to_light, lobes.alpha));
  }

  // Wide lobes: seven points of the light; narrow ones: the share of the lobe that the light fills.
  vec3 side = lobes.mirror - dot(lobes.mirror, to_light) * to_light;
  float away = length(side);
  side /= max(away, 1e-9);
  vec3 other = cross(to_light, side);
  float narrow = ps_narrow(lobes, sigma);
  vec3 lobe = vec3(0.0);
  if (narrow < 1.0) {
    float alpha = ps_blurred_alpha(lobes, sigma);
    for (int i = 0; i < 7; i++) {
      vec3 point = ps_disk_point(i);
      float turn = length(point.xy) * sigma;
      vec2 azimuth = i == 0 ? vec2(0.0) : normalize(point.xy);
      vec3 direction = cos(turn) * to_light + sin(turn) * (azimuth.x * side + azimuth.y * other);
      lobe += point.z * ps_specular(lobes, normal, to_eye, direction, alpha);
    }
  }
  if (narrow > 0.0) {
    float angle = atan(away, dot(lobes.mirror, to_light));
    float width = ps_width_along(lobes, cross(other, lobes.mirror));
    float share = ps_disk_share(angle, sigma, width, ps_width_along(lobes, other));
    float half_sine = sin(0.5 * sigma);
    float solid_angle = 4.0 * PS_PI * half_sine * half_sine;
    lobe = mix(lobe, lobes.reflectance * share / solid_angle, narrow);
  }
  return PsReceived(irradiance, energy * lobe);
}

#ifdef PS_HAS_AREA_LIGHTS

float ps_edge(vec3 a, vec3 b, vec3 normal)
{
  vec3 c = cross(a, b);
  float len = length(c);
  return len < 1e-30 ? 0.0 : atan(len, dot(a, b)) * dot(c, normal) / len;
}

float ps_triangle(vec3 a, vec3 b, vec3 c)
{
  return 2.0 * atan(abs(dot(a, cross(b, c))), 1.0 + dot(a, b) + dot(b, c) + dot(c, a));
}

vec3 ps_corner(PsLight light, vec3 offset, int i)
{
  if (light.shape.x < 0.5) {
    float s = (i == 0 || i == 3) ? -1.0 : 1.0;
    float t = i < 2 ? -1.0 : 1.0;
    return offset + s * light.axis_u + t * light.axis_v;
  }
  // A polygon with the ellipse's area.
  float step = 2.0 * PS_PI / float(PS_ELLIPSE_SIDES);
  float grow = sqrt(step / sin(step));
  return offset + grow * (cos(step * float(i)) * light.axis_u + sin(step * float(i)) * light.axis_v);
}

// Lambert's formula, cut by the horizon: a convex polygon leaves and enters the upper side at most once.
float ps_area_irradiance(PsLight light, vec3 offset, vec3 normal)
{
  int sides = light.shape.x < 0.5 ? 4 : PS_ELLIPSE_SIDES;
  vec3 a = ps_corner(light, offset, sides - 1);
  float above = dot(a, normal);
  vec3 leaving = vec3(0.0), entering = vec3(0.0);
  float total = 0.0;
  for (int i = 0; i < sides; i++) {
    vec3 b = ps_corner(light, offset, i);
    float below = dot(b, normal);
    if (above > 0.0 || below > 0.0) {
      vec3 start = a, end = b;
      if (above <= 0.0) {
        start = entering = mix(a, b, above / (above - below));
      }
      if (below <= 0.0) {
        end = leaving = mix(a, b, above / (above - below));
      }
      total += ps_edge(start, end, normal);
    }
    a = b;
    above = below;
  }
  return 0.5 * abs(total + ps_edge(leaving, entering, normal));
}

// Blender's soft-box grid: the share of light at an angle from the light's normal.
float ps_beam(float cosine, float half_spread)
{
  float limit = tan(half_spread);
  float tangent = sqrt(max(1.0 - cosine * cosine, 0.0)) / max(cosine, 1e-6);
  float scale = half_spread > 0.05 ? limit - half_spread : half_spread * half_spread * half_spread / 3.0;
  return max(limit - tangent, 0.0) / max(scale, 1e-12);
}

// A light whose beam is narrowed: a grid over the part that can shine here.
float ps_narrow_irradiance(PsLight light, vec3 offset, vec3 normal)
{
  vec2 extent = vec2(length(light.axis_u), length(light.axis_v));
  vec3 unit_u = light.axis_u / extent.x, unit_v = light.axis_v / extent.y;
  float height = max(-dot(offset, light.direction), 1e-9);
  vec2 foot = -vec2(dot(offset, unit_u), dot(offset, unit_v));
  float reach = height * tan(light.shape.y);
  vec2 low = max(foot - reach, -extent), high = min(foot + reach, extent);
  vec2 size = max(high - low, 0.0) / float(PS_SPREAD_CELLS);
  float total = 0.0;
  for (int i = 0; i < PS_SPREAD_CELLS * PS_SPREAD_CELLS; i++) {
    vec2 place = low + size * (vec2(float(i % PS_SPREAD_CELLS), float(i / PS_SPREAD_CELLS)) + 0.5);
    vec2 relative = place / extent;
    if (light.shape.x > 0.5 && dot(relative, relative) > 1.0) {
      continue;
    }
    vec3 to_light = offset + place.x * unit_u + place.y * unit_v;
    float d2 = dot(to_light, to_light);
    float d = sqrt(d2);
    total += ps_beam(height / d, light.shape.y) * max(dot(to_light, normal) / d, 0.0) * height / (d * d2);
  }
  return total * size.x * size.y;
}

// The share of an area light's radiance that leaves it against a unit direction towards it.
float ps_light_beam(PsLight light, vec3 direction)
{
  bool narrowed = light.shape.y < 0.5 * PS_PI * 0.9999;
  return narrowed ? ps_beam(-dot(direction, light.direction), light.shape.y) : 1.0;
}

// A quadrature of degree 5 over an area light: place in half-sides, and weight.
vec3 ps_area_point(PsLight light, int i)
{
  if (light.shape.x > 0.5) {
    return ps_disk_point(i);
  }
  int column = i % 3, row = i / 3;
  float weight = (column == 1 ? 8.0 : 5.0) * (row == 1 ? 8.0 : 5.0) / 324.0;
  return vec3(sqrt(0.6) * vec2(float(column - 1), float(row - 1)), weight);
}

// Share of the lobe that the light fills, where the mirrored ray meets the light's plane.
float ps_area_share(PsLight light, vec3 offset, float height, PsLobes lobes)
{
  vec2 extent = vec2(length(light.axis_u), length(light.axis_v));
  vec3 unit_u = light.axis_u / extent.x, unit_v = light.axis_v / extent.y;
  float ray = height / max(-dot(lobes.mirror, light.direction), 1e-4);
  vec3 meets = ray * lobes.mirror - offset;
  vec2 place = vec2(dot(meets, unit_u), dot(meets, unit_v)) / extent;
  vec2 width = vec2(ps_width_along(lobes, unit_u), ps_width_along(lobes, unit_v)) * ray / extent;
  float share;
  if (light.shape.x > 0.5) {
    float radius = length(place);
    vec2 azimuth = radius > 0.0 ? place / max(radius, 1e-9) : vec2(1.0, 0.0);
    share = ps_disk_share(radius, 1.0, length(azimuth * width), length(azimuth.yx * width));
  }
  else {
    share = ps_rectangle_share(place, width);
  }
  return share * ps_light_beam(light, lobes.mirror);
}

PsReceived ps_area_light(PsLight light, vec3 position, vec3 normal, vec3 to_eye, PsLobes lobes)
{
  vec3 offset = light.position - position;
  float height = -dot(offset, light.direction);
  if (height <= 0.0) {
    return PsReceived(0.0, vec3(0.0));
  }
  bool narrowed = light.shape.y < 0.5 * PS_PI * 0.9999;
  float irradiance = narrowed ? ps_narrow_irradiance(light, offset, normal)
                              : ps_area_irradiance(light, offset, normal);

  bool ellipse = light.shape.x > 0.5;
  vec3 c0 = normalize(offset - light.axis_u - light.axis_v), c1 = normalize(offset + light.axis_u - light.axis_v);
  vec3 c2 = normalize(offset + light.axis_u + light.axis_v), c3 = normalize(offset - light.axis_u + light.axis_v);
  float solid_angle = (ps_triangle(c0, c1, c2) + ps_triangle(c0, c2, c3)) * (ellipse ? PS_PI / 4.0 : 1.0);
  float sigma = sqrt(solid_angle / PS_PI);

  // Wide lobes: points of the light, weighted with the solid angle around them; narrow ones: the share.
  float narrow = ps_narrow(lobes, sigma);
  vec3 reflected = vec3(0.0);
  if (narrow < 1.0) {
    float alpha = ps_blurred_alpha(lobes, sigma);
    vec3 sum = vec3(0.0);
    float weights = 0.0;
    for (int i = 0; i < (ellipse ? 7 : 9); i++) {
      vec3 point = ps_area_point(light, i);
      vec3 to_point = offset + point.x * light.axis_u + point.y * light.axis_v;
      float inverse = inversesqrt(max(dot(to_point, to_point), 1e-20));
      float weight = point.z * inverse * inverse * inverse;
      vec3 direction = to_point * inverse;
      sum += weight * ps_light_beam(light, direction) * ps_specular(lobes, normal, to_eye, direction, alpha);
      weights += weight;
    }
    reflected = solid_angle * sum / weights;
  }
  if (narrow > 0.0) {
    reflected = mix(reflected, lobes.reflectance * ps_area_share(light, offset, height, lobes), narrow);
  }
  return PsReceived(irradiance, reflected);
}

#endif

// Radiance that the surface reflects of light `index`.
vec3 ps_shade_light(int index, vec3 position, vec3 normal, vec3 to_eye, PsLobes lobes)
{
  PsLight light = ps_light(index);
  PsReceived received;
#ifdef PS_HAS_AREA_LIGHTS
  if (light.kind == PS_KIND_AREA) {
    received = ps_area_light(light, position, normal, to_eye, lobes);
  }
  else {
    received = ps_round_light(light, position, normal, to_eye, lobes);
  }
#else
  received = ps_round_light(light, position, normal, to_eye, lobes);
#endif
  vec3 diffuse = received.irradiance / PS_PI * lobes.diffuse;
  return light.color * (light.diffuse * diffuse + light.specular * received.specular);
}

#endif

// Radiance towards the eye at a point in view space. normal and to_eye are unit; the surface is two-sided: the normal
// is turned to the viewer. light_count: how many rows of lights ps_lights holds.
vec3 ps_shade(vec3 position, vec3 normal, vec3 to_eye, PsSurface surface, int light_count)
{
  vec3 result = surface.emission;
#if defined(PS_HAS_LIGHTS) || defined(PS_HAS_WORLD) || defined(PS_HAS_ENVIRONMENT)
  normal = dot(normal, to_eye) < 0.0 ? -normal : normal;
  PsLobes lobes = ps_lobes(surface, normal, to_eye);
#ifdef PS_HAS_LIGHTS
  for (int i = 0; i < light_count; i++) {
    result += ps_shade_light(i, position, normal, to_eye, lobes);
  }
#endif
  result += ps_shade_world(lobes, surface.roughness, normal);
#endif
  return result;
}
