// The Principled BSDF without coat, sheen, transmission and subsurface: GGX with multiple scattering over Lambert.
// Reference and sources: core/lighting.py. Reads ps_lights (rows 0 .. PS_TABLE_ROWS: the reflectance table).

#define PS_PI 3.14159265358979
#define PS_TABLE_WIDTH 32
#define PS_TABLE_ROWS 32
#define PS_MIN_ALPHA 1e-3

struct PsSurface {
  vec3 base;
  vec3 emission;
  float roughness;
  float metallic;
  float ior;
  float specular;
};

#if defined(PS_HAS_LIGHTS) || defined(PS_HAS_WORLD) || defined(PS_HAS_ENVIRONMENT)

// What the BSDF needs of a surface seen from one direction.
struct PsLobes {
  vec3 diffuse;
  vec3 reflectance;  // of uniform light, by the GGX lobe
  vec3 metal_f0;
  vec3 metal_scale;
  float dielectric_scale;
  float eta;
  float alpha;
  float cos_eye;
  vec3 mirror;  // the reflected view direction
  vec3 across;  // unit, perpendicular to the plane of incidence; 0 where there is none
};

float ps_fresnel_dielectric(float cosine, float eta)
{
  if (eta == 1.0) {
    return 0.0;
  }
  float g2 = eta * eta - 1.0 + cosine * cosine;
  if (g2 < 0.0) {
    return 1.0;
  }
  float g = sqrt(g2);
  float a = (g - cosine) / max(g + cosine, 1e-9);
  float b = ((g + cosine) * cosine - 1.0) / max((g - cosine) * cosine + 1.0, 1e-9);
  return clamp(0.5 * a * a * (1.0 + b * b), 0.0, 1.0);
}

// Cosine-weighted mean over the hemisphere (fits of Kulla and Conty 2017).
float ps_mean_fresnel(float eta)
{
  float dense = (eta - 1.0) / (4.08567 + 1.00071 * eta);
  float thin = 0.997118 + eta * (0.1014 - eta * (0.965241 + 0.130607 * eta));
  return clamp(eta >= 1.0 ? dense : thin, 0.0, 1.0);
}

vec4 ps_reflectance_table(float cosine, float roughness)
{
  float x = sqrt(cosine) * float(PS_TABLE_WIDTH - 1);
  float y = roughness * float(PS_TABLE_ROWS - 1);
  int x0 = min(int(x), PS_TABLE_WIDTH - 2);
  int y0 = min(int(y), PS_TABLE_ROWS - 2);
  float fx = x - float(x0);
  vec4 low = mix(texelFetch(ps_lights, ivec2(x0, y0), 0), texelFetch(ps_lights, ivec2(x0 + 1, y0), 0), fx);
  vec4 high = mix(texelFetch(ps_lights, ivec2(x0, y0 + 1), 0), texelFetch(ps_lights, ivec2(x0 + 1, y0 + 1), 0), fx);
  return mix(low, high, y - float(y0));
}

PsLobes ps_lobes(PsSurface surface, vec3 normal, vec3 to_eye)
{
  PsLobes lobes;
  float roughness = clamp(surface.roughness, 0.0, 1.0);
  float metallic = clamp(surface.metallic, 0.0, 1.0);
  lobes.alpha = max(roughness * roughness, PS_MIN_ALPHA);
  lobes.cos_eye = clamp(dot(normal, to_eye), 1e-4, 1.0);
  lobes.mirror = 2.0 * dot(normal, to_eye) * normal - to_eye;
  lobes.across = cross(normal, to_eye);
  float sine = length(lobes.across);
  lobes.across = sine > 1e-6 ? lobes.across / sine : vec3(0.0);
  lobes.metal_f0 = clamp(surface.base, 0.0, 1.0);

  // The specular level scales F0, which stands for another index.
  float f0 = (surface.ior - 1.0) / (surface.ior + 1.0);
  f0 = min(f0 * f0 * 2.0 * max(surface.specular, 0.0), 0.99);
  float eta = (1.0 + sqrt(f0)) / (1.0 - sqrt(f0));
  lobes.eta = surface.ior < 1.0 ? 1.0 / eta : eta;

  // Single scattering from the table, multiple over single scattering as a factor.
  vec4 table = ps_reflectance_table(lobes.cos_eye, roughness);
  float missing = (1.0 - table.x) / table.x;
  vec3 metal_mean = lobes.metal_f0 + (1.0 - lobes.metal_f0) / 21.0;
  float dielectric_mean = ps_mean_fresnel(lobes.eta);
  vec3 metal_scattered = 1.0 + missing * metal_mean * table.w / (1.0 - metal_mean * (1.0 - table.w));
  float scattered = 1.0 + missing * dielectric_mean * table.w / (1.0 - dielectric_mean * (1.0 - table.w));
  lobes.metal_scale = metallic * metal_scattered;
  lobes.dielectric_scale = (1.0 - metallic) * scattered;

  float reflected = lobes.eta == 1.0 ? 0.0 : mix(f0, 1.0, table.z) * table.x * scattered;
  vec3 metal_reflected = mix(lobes.metal_f0, vec3(1.0), table.y) * table.x;
  lobes.reflectance = (1.0 - metallic) * reflected + lobes.metal_scale * metal_reflected;
  lobes.diffuse = max(surface.base, 0.0) * (1.0 - metallic) * (1.0 - min(reflected, 1.0));
  return lobes;
}

// Angle by which reflected rays turn along a unit direction where the half vector's slope is alpha, per unit of length
// along `direction` at unit distance.
float ps_width_along(PsLobes lobes, vec3 direction)
{
  vec3 seen = direction - dot(direction, lobes.mirror) * lobes.mirror;
  float size2 = max(dot(seen, seen), 1e-6);
  float across = dot(seen, lobes.across);
  return 2.0 * lobes.alpha * sqrt((1.0 - across * across / size2 * (1.0 - lobes.cos_eye * lobes.cos_eye)) / size2);
}

// BSDF of the GGX lobe times n.l, where the lobe may be widened to another alpha.
vec3 ps_specular(PsLobes lobes, vec3 normal, vec3 to_eye, vec3 direction, float alpha)
{
  float cos_light = dot(normal, direction);
  if (cos_light <= 0.0) {
    return vec3(0.0);
  }
  cos_light = max(cos_light, 1e-6);
  vec3 middle = normalize(direction + to_eye);
  float cos_half = dot(normal, middle);
  float cos_between = clamp(dot(middle, direction), 0.0, 1.0);
  float a2 = alpha * alpha;
  // |n x h|^2 in place of 1 - (n.h)^2, which cancels.
  vec3 sine = cross(normal, middle);
  float spread = a2 * cos_half * cos_half + dot(sine, sine);
  float density = a2 / (PS_PI * spread * spread);
  float visibility = 0.5 / (cos_light * sqrt(a2 + (1.0 - a2) * lobes.cos_eye * lobes.cos_eye) +
                            lobes.cos_eye * sqrt(a2 + (1.0 - a2) * cos_light * cos_light));
  vec3 metal = lobes.metal_f0 + (1.0 - lobes.metal_f0) * pow(1.0 - cos_between, 5.0);
  float dielectric = ps_fresnel_dielectric(cos_between, lobes.eta);
  return density * visibility * cos_light * (lobes.metal_scale * metal + lobes.dielectric_scale * dielectric);
}

#endif
