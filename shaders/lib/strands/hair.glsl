// Light on strands that are seen as a whole, across all their width. Float64 twin, sources and terms:
// tests/reference/hair_lighting.py.
// The entry is ps_shade_strand. Of the material table's fourth texel: x 1 and the escape: hair; y the coat, 8 bits,
// and azimuthal roughness as a fraction; z tilt; w factors of R, TT and TRT, 8 bits each.

#define PS_TT_VARIANCE 0.28
#define PS_WIDEST 3.24
#define PS_TRT_SPREAD 0.14
#define PS_LEAST_ROUGHNESS 0.08
#define PS_LEAST_VARIANCE 1e-3
#define PS_DARKEST 1e-6
#define PS_TYPICAL 0.8165  // cosine about the axis from the middle of what is seen of a cylinder: the root of its mean square

#if defined(PS_HAS_LIGHTS) || defined(PS_HAS_WORLD) || defined(PS_HAS_ENVIRONMENT) || defined(PS_INDIRECT)

// The scattering of a strand towards the eye, common to all lights.
struct PsStrand {
  vec3 tangent;
  vec3 across;  // to the eye, less what is along the tangent
  float theta;  // of the eye
  vec3 mirror;  // R, or the surface of a cylinder: what it reflects that is met straight on, where that is a metal,
  float metal;  // the share of metal, and
  float dielectric;  // the factor of all else
  float eta;
  vec3 through;  // energies: TT
  vec3 again;  // TRT
  vec3 rest;  // further bounces
  vec3 diffuse;  // by other strands; of a cylinder by itself
  vec3 before, behind;  // of the light of the world in front of the strand and behind it
  float variance;
  float smoothest;  // variance of R
  float spread;  // squared scale of the azimuthal logistic; less than 0: a cylinder of another material
  float tilt;
};

float ps_power(float x, int n)
{
  float result = 1.0;
  for (; n > 0; n >>= 1) {
    result *= (n & 1) == 1 ? x : 1.0;
    x *= x;
  }
  return result;
}

// i0(x) exp(-x), x >= 0 (Abramowitz and Stegun 9.8.1, 9.8.2).
float ps_scaled_i0(float x)
{
  float t = x / 3.75, s = t * t;
  float low = 1.0 + s * (3.5156229 + s * (3.0899424 + s * (1.2067492 + s * (0.2659732 +
              s * (0.0360768 + s * 0.0045813)))));
  float i = 1.0 / max(t, 1.0);
  float high = 0.39894228 + i * (0.01328592 + i * (0.00225319 + i * (-0.00157565 + i * (0.00916281 +
               i * (-0.02057706 + i * (0.02635537 + i * (-0.01647633 + i * 0.00392377)))))));
  return x < 3.75 ? low * exp(-x) : high * inversesqrt(max(x, 1.0));
}

float ps_longitudinal(float theta, float other, float variance)
{
  // Tilted past the tangent: the angle of the same sine.
  other = (other < 0.0 ? -1.0 : 1.0) * (0.5 * PS_PI - abs(0.5 * PS_PI - abs(other)));
  float off = sin(0.5 * (theta + other));
  float a = max(cos(theta) * cos(other), 0.0) / variance;
  return ps_scaled_i0(a) * exp(-2.0 * off * off / variance) / (variance * (1.0 - exp(-2.0 / variance)));
}

float ps_logistic(float x, float scale)
{
  float e = exp(-abs(x) / scale), tail = exp(-PS_PI / scale);
  return e * (1.0 + tail) / (scale * (1.0 + e) * (1.0 + e) * (1.0 - tail));
}

float ps_wrapped_normal(float x, float variance)
{
  float other = 2.0 * PS_PI - x;
  return (exp(-0.5 * x * x / variance) + exp(-0.5 * other * other / variance)) * inversesqrt(2.0 * PS_PI * variance);
}

vec3 ps_absorption(vec3 color, float b)
{
  vec3 root = log(clamp(color, PS_DARKEST, 1.0)) /
              (5.969 + b * (-0.215 + b * (2.532 + b * (-10.73 + b * (5.574 + b * 0.245)))));
  return root * root;
}

float ps_lobe_variance(float roughness)
{
  float b = max(roughness, PS_LEAST_ROUGHNESS);
  float root = 0.726 * b + 0.812 * b * b + 3.7 * ps_power(b, 20);
  return root * root;
}

// asin, exact near +-1, where some drivers' is not.
float ps_latitude(float sine)
{
  return atan(sine, sqrt(max((1.0 - sine) * (1.0 + sine), 0.0)));
}

PsStrand ps_strand(PsSurface surface, vec4 fibre, vec3 tangent, vec3 to_eye)
{
  PsStrand strand;
  float sine = clamp(dot(to_eye, tangent), -1.0, 1.0);
  float cosine = sqrt(max((1.0 - sine) * (1.0 + sine), 0.0));
  strand.tangent = tangent;
  strand.across = to_eye - sine * tangent;
  strand.theta = atan(sine, cosine);
  bool hair = fibre.x > 0.5;
  float roughness = clamp(surface.roughness, 0.0, 1.0);
  float radial = max(fract(fibre.y), PS_LEAST_ROUGHNESS);
  vec3 sigma = ps_absorption(surface.base, fract(fibre.y));
  float eta = surface.eta;
  float bent = sqrt(max(eta * eta - sine * sine, 1e-9)) / max(cosine, 1e-4);
  float inside = sqrt(max(1.0 - sine * sine / (eta * eta), 1e-9));
  vec3 reflected = vec3(0.0), through = vec3(0.0), again = vec3(0.0), rest = vec3(0.0);
  float grazing = 0.0;
  for (int i = 0; i < 3; i++) {
    float h = i == 0 ? 0.16932809 : (i == 1 ? 0.65127062 : 0.9549115);
    float weight = i == 0 ? 0.40186383 : (i == 1 ? 0.45848221 : 0.13965396);
    float facing = cosine * sqrt(1.0 - h * h);
    float f = eta == 1.0 ? 0.0 : ps_fresnel_dielectric(facing, eta);
    vec3 passed = exp(-sigma * (2.0 * sqrt(max(1.0 - h * h / (bent * bent), 0.0)) / inside));
    vec3 one = (1.0 - f) * (1.0 - f) * passed, two = one * passed * f;
    reflected += weight * f;
    through += weight * one;
    again += weight * two;
    rest += weight * two * passed * f / max(1.0 - passed * f, 1e-6);
    float x = 1.0 - facing, x2 = x * x;
    grazing += weight * x2 * x2 * x;
  }
  float coat = floor(fibre.y) / 255.0, escape = fibre.x - 1.0;
  float variance = ps_lobe_variance(surface.roughness), smoothest = ps_lobe_variance(surface.roughness * (1.0 - coat));
  float scale = sqrt(PS_PI / 8.0) * (0.265 * radial + 1.194 * radial * radial + 5.372 * ps_power(radial, 22));
  // Of any other material.
  float metallic = clamp(surface.metallic, 0.0, 1.0);
  vec3 f0 = clamp(surface.base, 0.0, 1.0);
  vec3 diffuse = (1.0 - metallic) * (1.0 - reflected) * max(surface.base, 0.0);
  vec3 mirrored = (1.0 - metallic) * reflected + metallic * (f0 + (1.0 - f0) * grazing);
#ifndef PS_SHOWS_DIFFUSE
  diffuse = vec3(0.0);
#endif
#ifndef PS_SHOWS_GLOSSY
  mirrored = vec3(0.0);
#endif
  int coded = int(fibre.w);
  vec3 lobes = vec3(coded & 255, (coded >> 8) & 255, coded >> 16) / 255.0;
  strand.mirror = f0;
#ifdef PS_SHOWS_GLOSSY
  strand.metal = hair ? 0.0 : metallic;
  strand.dielectric = hair ? lobes.x : 1.0 - metallic;
#else
  strand.metal = 0.0;
  strand.dielectric = hair ? lobes.x : 0.0;
#endif
  strand.eta = eta;
  through *= lobes.y;
  again *= lobes.z;
  vec3 every = lobes.x * reflected + through + again + rest;
  vec3 whole = every * escape / max(1.0 - every * (1.0 - escape), 1e-6);
  vec3 back = clamp(whole - every + (1.0 - escape) * through, vec3(0.0), (1.0 - escape) * through);
  strand.through = hair ? escape * through : vec3(0.0);
  strand.again = hair ? again : vec3(0.0);
  strand.rest = hair ? rest : vec3(0.0);
  strand.diffuse = hair ? back : diffuse;
  vec3 held = whole / max(every, 1e-6);  // other strands hold off the world
  strand.behind = hair ? held * escape * through : vec3(0.0);
  strand.before = hair ? whole - strand.behind : mirrored + diffuse;
  float other = max(2.0 * ps_power(roughness, 4), PS_LEAST_VARIANCE);
  strand.variance = hair ? variance : other;
  strand.smoothest = hair ? smoothest : other;
  strand.spread = hair ? scale * scale : -1.0;
  strand.tilt = hair ? fibre.z : 0.0;
#ifndef PS_SHOWS_GLOSSY
  // All that hair scatters is glossy in Cycles.
  if (hair) {
    strand.dielectric = 0.0;
    strand.through = strand.again = strand.rest = strand.diffuse = strand.before = strand.behind = vec3(0.0);
  }
#endif
  return strand;
}

// Radiance per irradiance on a plane that faces the light: by the surface, and all else. spread: variance of the
// light's directions along each axis.
void ps_scattered(PsStrand strand, vec3 direction, float spread, out vec3 reflected, out vec3 rest)
{
  float sine = clamp(dot(direction, strand.tangent), -1.0, 1.0);
  vec3 across = direction - sine * strand.tangent;
  float theta = ps_latitude(sine);
  float phi = abs(atan(dot(cross(strand.across, across), strand.tangent), dot(strand.across, across)));
  float eye = strand.theta, tilt = strand.tilt, v = strand.variance;
  // Where the normal lies halfway between both directions.
  float facing = clamp(cos(strand.theta) * cos(0.5 * phi), 0.0, 1.0);
  vec3 mirrored = strand.dielectric * vec3(strand.eta == 1.0 ? 0.0 : ps_fresnel_dielectric(facing, strand.eta)) +
                  strand.metal * (strand.mirror + (1.0 - strand.mirror) * ps_power(1.0 - facing, 5));
  reflected = mirrored *
              (ps_longitudinal(theta, eye + 2.0 * tilt, strand.smoothest + spread) * 0.25 * cos(0.5 * phi));
  float square = (1.0 - sine * sine) * (1.0 - 2.0 * spread) + spread, off = spread / max(square, 1e-6);
  float lit = 4.0 / PS_PI + ((PS_PI - phi) * cos(phi) + sin(phi) - 4.0 / PS_PI) * exp(-0.5 * off);
  rest = strand.diffuse * (sqrt(max(square, 0.0)) * lit / (4.0 * PS_PI));
  if (strand.spread < 0.0) {
    return;
  }
  float inner = ps_longitudinal(theta, eye - 4.0 * tilt, 4.0 * v + spread);
  float azimuth = strand.spread + 3.0 / (PS_PI * PS_PI) * off;
  float straight = min(PS_PI * PS_PI / 3.0 * azimuth + PS_TT_VARIANCE, PS_WIDEST);
  float tt = ps_longitudinal(theta, eye - tilt, 0.25 * v + spread) * ps_wrapped_normal(PS_PI - phi, straight);
  float trt = inner * ps_logistic(phi, sqrt(azimuth + PS_TRT_SPREAD * PS_TRT_SPREAD));
  rest += strand.through * tt + strand.again * trt + strand.rest * (inner / (2.0 * PS_PI));
}

// The mean radiance of the world around a direction in view space.
vec3 ps_world_around(vec3 direction)
{
#if defined(PS_INDIRECT)
  return ps_gathered.rgb;
#elif defined(PS_HAS_ENVIRONMENT)
  return ps_environment_level(ps_uv_from_direction(ps_image_from_view(direction)), PS_ROUGH_LEVELS + 1);
#else
  return ps_ambient();
#endif
}

#ifdef PS_HAS_LIGHTS

// Variance of the directions along each axis from which light `index` shines on a point in view space.
float ps_light_spread(int index, ivec4 ends, vec3 position)
{
  float spread = 0.0;
#ifdef PS_HAS_WIDE_LIGHTS
  vec3 offset = ps_light(index, 1).xyz - position;
  float size = ps_light(index, 2).w, d2 = dot(offset, offset), r2 = size * size;
  spread = 0.25 * (index < ends.x ? size : r2 / max(size < 0.0 ? max(d2, r2) : d2 + r2, 1e-20));
#endif
#ifdef PS_HAS_AREA_LIGHTS
  if (index >= ends.z) {
    PsArea area = ps_area(index, ps_light(index, 1).xyz - position);
    spread = ps_rectangle_solid_angle(area) * (index < ends.w ? 0.25 / PS_PI : 0.0625);
  }
#endif
  return min(spread, 0.5);
}

#endif
#endif

// Radiance towards the eye of a strand, in view space; vectors are unit.
vec3 ps_shade_strand(vec3 position, vec3 tangent, vec3 to_eye, PsSurface surface, vec4 fibre, int light_count)
{
#if defined(PS_TERM_OCCLUSION)
  vec3 result = ps_unoccluded();
#elif defined(PS_SHOWS_EMISSION)
  vec3 result = surface.emission;
#else
  vec3 result = vec3(0.0);
#endif
#if !defined(PS_TERM_OCCLUSION) && (defined(PS_HAS_LIGHTS) || defined(PS_HAS_WORLD) || defined(PS_HAS_ENVIRONMENT) || defined(PS_INDIRECT))
  PsStrand strand = ps_strand(surface, fibre, tangent, to_eye);
#if defined(PS_TERM_COLOR)
#ifdef PS_SHOWS_GLOSSY
  result += fibre.x > 0.5 ? surface.base : strand.before;
#else
  result += strand.before;
#endif
#elif defined(PS_SHOWS_SURFACES)
#ifdef PS_HAS_LIGHTS
  ivec4 ends = ps_light_ends();
  for (int i = 0; i < light_count; i++) {
    vec3 to_light, reflected, rest;
    vec3 irradiance = ps_ball_irradiance(i, ends, position, to_light);
    ps_scattered(strand, to_light, ps_light_spread(i, ends, position), reflected, rest);
    float diffuse = ps_light(i, 0).w, specular = ps_light(i, 1).w;
    result += ps_reaching(i, irradiance, position, vec3(0.0)) * (specular * reflected + diffuse * rest);
  }
#endif
  vec3 facing = normalize(strand.across + 1e-9 * to_eye);
#if defined(PS_INDIRECT) && !defined(PS_TERM_OCCLUSION)
  // Of a cylinder what falls on it, and what it mirrors, is known as the mean over its width.
  for (int i = 0; i < (strand.spread < 0.0 ? 1 : 0); i++) {
    vec3 typical = PS_TYPICAL * facing + sqrt(1.0 - PS_TYPICAL * PS_TYPICAL) * cross(tangent, facing);
    PsLobes lobes = ps_lobes(surface, typical, typical, to_eye);
#ifdef PS_TERM
    ps_keep_term(lobes);
#endif
    result += ps_shade_world(lobes);
  }
  float whole = strand.spread < 0.0 ? 0.0 : 1.0;
#else
  const float whole = 1.0;
#endif
  result += whole * (ps_world_around(facing) * strand.before + ps_world_around(-facing) * strand.behind);
#endif
#endif
  return result;
}
