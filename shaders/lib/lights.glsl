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
  float energy;  // radiance times solid angle
  vec3 direction;  // to the representative point
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

// How far towards its rim a light of angular radius sigma moves its representative point (x), and the mean of a
// Gaussian lobe over it relative to the peak (y).
vec2 ps_shrink(float sigma, float width)
{
  float x = sigma * sigma / (width * width);
  // The series where 1 - exp(-x / 2) cancels.
  float focus = x < 0.02 ? 1.0 - x * (0.25 - x / 24.0) : (1.0 - exp(-0.5 * x)) / (0.5 * x);
  return vec2(x / (1.0 + x), focus);
}

vec3 ps_towards(vec3 start, vec3 goal, float angle)
{
  float cosine = dot(start, goal);
  vec3 side = goal - cosine * start;
  float len = length(side);
  float turn = min(atan(len, cosine), angle);
  return cos(turn) * start + sin(turn) * side / max(len, 1e-9);
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
  float centre = ps_spot_cone(light, ray);
  if (light.radius <= 0.0) {
    return vec2(centre);
  }
  // Aligned with the cone, so that the camera's turning changes nothing.
  bool aside = abs(dot(to_light, light.direction)) < 0.999;
  vec3 u = normalize(cross(aside ? light.direction : light.axis_u, to_light));
  vec3 v = cross(to_light, u);
  float radius = light.radius * sqrt(2.0 / 3.0);
  float weights = 0.25 * max(-dot(ray, normal), 0.0);
  vec2 total = centre * vec2(0.25, weights);
  for (int i = 0; i < 6; i++) {
    float angle = float(i) * PS_PI / 3.0;
    vec3 from_point = ray - radius * (cos(angle) * u + sin(angle) * v);
    float weight = 0.125 * max(-dot(from_point, normal), 0.0);
    total += ps_spot_cone(light, from_point) * vec2(0.125, weight);
    weights += weight;
  }
  return vec2(total.x, weights > 0.0 ? total.y / weights : total.x);
}

PsReceived ps_round_light(PsLight light, vec3 position, vec3 normal, vec3 mirror, float width)
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
  vec2 shrink = ps_shrink(sigma, width);
  float energy = strength * cone.x * 2.0 / (1.0 + cosine) * shrink.y;
  // Inside a sphere light comes from everywhere.
  float received = inside ? 1.0 : ps_cap_cosine(dot(normal, to_light), sine2);
  return PsReceived(strength * cone.y * received, energy,
                    ps_towards(to_light, mirror, sigma * shrink.x));
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

PsReceived ps_area_light(PsLight light, vec3 position, vec3 normal, vec3 mirror, float width)
{
  vec3 offset = light.position - position;
  float height = -dot(offset, light.direction);
  if (height <= 0.0) {
    return PsReceived(0.0, 0.0, normal);
  }
  bool narrowed = light.shape.y < 0.5 * PS_PI * 0.9999;
  float irradiance = narrowed ? ps_narrow_irradiance(light, offset, normal)
                              : ps_area_irradiance(light, offset, normal);

  // Where the mirrored ray meets the light's plane, drawn towards a light that is small against the lobe.
  vec2 extent = vec2(length(light.axis_u), length(light.axis_v));
  vec3 unit_u = light.axis_u / extent.x, unit_v = light.axis_v / extent.y;
  float distance_centre = max(length(offset), 1e-20);
  vec3 centre = offset / distance_centre;
  vec2 slant = vec2(dot(centre, unit_u), dot(centre, unit_v));
  vec2 sigma = extent * sqrt(max(1.0 - slant * slant, 0.0)) / distance_centre;
  vec2 shrink_u = ps_shrink(sigma.x, width), shrink_v = ps_shrink(sigma.y, width);
  float ray = height / max(-dot(mirror, light.direction), 1e-4);
  vec2 place = vec2(dot(ray * mirror - offset, unit_u), dot(ray * mirror - offset, unit_v)) / extent;
  if (light.shape.x > 0.5) {
    place /= max(length(place), 1.0);
  }
  place = clamp(place, -1.0, 1.0) * vec2(shrink_u.x, shrink_v.x);
  vec3 direction = normalize(offset + place.x * light.axis_u + place.y * light.axis_v);

  vec3 c0 = normalize(offset - light.axis_u - light.axis_v), c1 = normalize(offset + light.axis_u - light.axis_v);
  vec3 c2 = normalize(offset + light.axis_u + light.axis_v), c3 = normalize(offset - light.axis_u + light.axis_v);
  float energy = (ps_triangle(c0, c1, c2) + ps_triangle(c0, c2, c3)) * sqrt(shrink_u.y * shrink_v.y);
  if (light.shape.x > 0.5) {
    energy *= PS_PI / 4.0;
  }
  if (narrowed) {
    energy *= ps_beam(-dot(direction, light.direction), light.shape.y);
  }
  return PsReceived(irradiance, energy, direction);
}

#endif

// Radiance that the surface reflects of light `index`.
vec3 ps_shade_light(int index, vec3 position, vec3 normal, vec3 to_eye, PsLobes lobes)
{
  PsLight light = ps_light(index);
  vec3 mirror = 2.0 * dot(normal, to_eye) * normal - to_eye;
  // The lobe's width as an angle of reflected rays: its half vectors fill a solid angle of pi alpha^2.
  float width = sqrt(2.0) * lobes.alpha;
  PsReceived received;
#ifdef PS_HAS_AREA_LIGHTS
  if (light.kind == PS_KIND_AREA) {
    received = ps_area_light(light, position, normal, mirror, width);
  }
  else {
    received = ps_round_light(light, position, normal, mirror, width);
  }
#else
  received = ps_round_light(light, position, normal, mirror, width);
#endif
  vec3 reflected = light.diffuse * received.irradiance / PS_PI * lobes.diffuse;
  if (received.energy > 0.0) {
    reflected += light.specular * received.energy * ps_specular(lobes, normal, to_eye, received.direction);
  }
  return light.color * reflected;
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
  result += ps_shade_world(lobes, surface.roughness, normal, to_eye);
#endif
  return result;
}
