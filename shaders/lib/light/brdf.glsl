// The Principled BSDF without transmission and subsurface: GGX with multiple scattering over Lambert, and PS_COAT, a
// clear layer above both. PS_BACKLIT: a share of the Lambert base is lit from the other side. PS_TINTED: the GGX lobe has a
// tint. PS_GLOSS: its metallic share may have a colour other than the base's. PS_ROUGH_DIFFUSE, PS_TOON: the base may be other
// than Lambert's. PS_SHEEN: fibres above all: diffuse_lobes.glsl.
// Reference and sources: core/light/bsdf.py. Reads ps_lights (rows 0 .. PS_TABLE_ROWS: the reflectance table).
// PS_HAS_METAL: something is metallic. PS_ONE_SURFACE: nothing is, and roughness and eta are those of the whole scene.

#include "lib/geometry/reflecting_normal.glsl"
#include "lib/light/terms.glsl"

#if defined(PS_ROUGH_DIFFUSE) || defined(PS_SHEEN) || defined(PS_TOON)
#define PS_DIFFUSE_LOBES  // the diffuse lobe may be another than Lambert's
#endif
#if defined(PS_COAT) || defined(PS_SHEEN)
#define PS_LAYERED
#endif
#ifdef PS_TINTED
#define PS_DIELECTRIC vec3
#else
#define PS_DIELECTRIC float
#endif
#ifdef PS_GLOSS
#define PS_METAL_GRAZING lobes.metal_grazing
#else
#define PS_METAL_GRAZING vec3(1.0)
#endif

#define PS_PI 3.14159265358979
#define PS_TABLE_WIDTH 32
#define PS_TABLE_ROWS 32
#define PS_SURFACE_ROW (PS_TABLE_ROWS + 1)
#define PS_MIN_ALPHA 1e-3
#define PS_WIDER_SUM 1.1
#define PS_TURNED_BY 10.0  // over alpha squared

struct PsSurface {
  vec3 base;
  vec3 emission;
  float roughness;
  float metallic;
  float eta;  // index of refraction that stands for IOR and specular level: core/light/bsdf.py, relative_index
#ifdef PS_SPREAD
  float spread;  // variance of the slopes of normals within the footprint, in both directions together
#endif
};

#ifdef PS_BACKLIT
vec3 ps_backlit;  // the share of diffuse light, of the surface that ps_material read last, that comes from behind
#endif

#ifdef PS_COAT
struct PsCoat {
  vec3 layer;  // weight, roughness, index of refraction
  vec3 tint;
};
PsCoat ps_coat;  // of the surface that ps_material read last
#endif

#ifdef PS_TINTED
vec3 ps_tint;  // of the surface that ps_material read last: what dielectrics reflect at normal incidence, and metals at 82 degrees
#endif
#ifdef PS_GLOSS
// Of the surface that ps_material read last: what its metallic share reflects, negative where that is the base colour; and
// whether it reflects alike at every angle, as the Glossy BSDF does.
vec4 ps_gloss;
#endif
#ifdef PS_ROUGH_DIFFUSE
float ps_diffuse_roughness;
#endif
#ifdef PS_SHEEN
vec4 ps_sheen;  // colour and roughness
#endif
#ifdef PS_TANGENT
vec3 ps_grain;  // along which the GGX lobe of the surface is stretched; as long as 1 - 1 / how much
#endif
#ifdef PS_TOON
vec3 ps_toon;  // size and smoothness; whether it is one
#endif

#if defined(PS_HAS_LIGHTS) || defined(PS_HAS_WORLD) || defined(PS_HAS_ENVIRONMENT) || defined(PS_INDIRECT)

// What the BSDF needs of a surface seen from one direction.
struct PsLobes {
  vec3 normal;  // of the diffuse lobe; light from behind it is reflected by neither
  vec3 reflecting;  // of the GGX lobe
  vec3 to_eye;
  vec3 diffuse;
  vec3 reflectance;  // of uniform light, by the GGX lobe
  vec3 metal_f0;
#ifdef PS_GLOSS
  vec3 metal_grazing;
#endif
  vec3 metal_scale;
  PS_DIELECTRIC dielectric_scale;
#ifdef PS_TINTED
  vec3 dielectric_f0;
  vec3 metal_dip;  // below Schlick's curve, by Kutz et al. 2021
#endif
#ifdef PS_DIFFUSE_LOBES
  vec3 even;  // of uniform light, by diffuse lobes
#endif
#ifdef PS_ROUGH_DIFFUSE
  float rough;
  vec3 again;  // what of light that was scattered more than once does not depend on where it comes from
#endif
#ifdef PS_TOON
  vec3 toon;
#endif
#ifdef PS_SHEEN
  vec3 fibres;  // what they reflect of uniform light
  vec2 bend;  // of the lobe, which is a cosine's, linearly transformed
#endif
#ifdef PS_TANGENT
  vec3 grain;  // unit, across `reflecting`; 0: the lobe is round
  float stretch;  // alpha along the grain over the mean one
  float own2;  // alpha squared of the material, its mean
#endif
#ifdef PS_LAYERED
  vec3 below;  // what layers above leave of the lobe
#endif
  float eta;
  float roughness;
  float alpha;
  float cos_eye;
#ifdef PS_SPREAD
  float spread;  // as the surface's
  float widened;  // what of alpha squared is the spread
#endif
  vec3 mirror;  // the reflected view direction
  vec3 across;  // unit, perpendicular to the plane of incidence; 0 where there is none
};

// Unpolarised, over one common denominator.
float ps_fresnel_dielectric(float cosine, float eta)
{
  float g2 = eta * eta - 1.0 + cosine * cosine;
  float g = sqrt(max(g2, 0.0));
  float a = g - cosine, b = g + cosine;
  float c = b * cosine - 1.0, d = a * cosine + 1.0;
  float both = a / max(b * d, 1e-9);
  return g2 < 0.0 ? 1.0 : min(0.5 * both * both * (d * d + c * c), 1.0);
}

// Cosine-weighted mean over the hemisphere (fits of Kulla and Conty 2017).
float ps_mean_fresnel(float eta)
{
  float dense = (eta - 1.0) / (4.08567 + 1.00071 * eta);
  float thin = 0.997118 + eta * (0.1014 - eta * (0.965241 + 0.130607 * eta));
  return clamp(eta >= 1.0 ? dense : thin, 0.0, 1.0);
}

float ps_most(vec3 color)
{
  return max(color.r, max(color.g, color.b));
}

vec4 ps_table_row(int row, float cosine)
{
  float x = sqrt(cosine) * float(PS_TABLE_WIDTH - 1);
  int column = min(int(x), PS_TABLE_WIDTH - 2);
  return mix(texelFetch(ps_lights, ivec2(column, row), 0), texelFetch(ps_lights, ivec2(column + 1, row), 0),
             x - float(column));
}

vec4 ps_reflectance_table(float cosine, float roughness)
{
  float y = roughness * float(PS_TABLE_ROWS - 1);
  int row = min(int(y), PS_TABLE_ROWS - 2);
  return mix(ps_table_row(row, cosine), ps_table_row(row + 1, cosine), y - float(row));
}

#ifdef PS_DIFFUSE_LOBES
#include "lib/light/diffuse_lobes.glsl"
#endif

#ifdef PS_TINTED
// By how much less metals reflect than Schlick's curve, at 82 degrees `tint` times as much.
vec3 ps_metal_dip(vec3 f0, vec3 tint)
{
  const float f = 6.0 / 7.0, f5 = f * f * f * f * f;
  return mix(f0, vec3(1.0), f5) * (7.0 / (f5 * f)) * (1.0 - tint);
}
#endif

// Leaves of the diffuse lobes Lambert's alone.
void ps_keep_lambert(inout PsLobes lobes)
{
#ifdef PS_DIFFUSE_LOBES
  lobes.even = lobes.diffuse;
#endif
#ifdef PS_ROUGH_DIFFUSE
  lobes.rough = 0.0;
  lobes.again = vec3(0.0);
#endif
#ifdef PS_TOON
  lobes.toon = vec3(0.0);
#endif
#ifdef PS_SHEEN
  lobes.fibres = vec3(0.0);
  lobes.bend = vec2(1.0, 0.0);
#endif
}

void ps_leave_out_glossy(inout PsLobes lobes)
{
  lobes.reflectance = lobes.metal_scale = vec3(0.0);
  lobes.dielectric_scale = PS_DIELECTRIC(0.0);
}

PsLobes ps_lobes(PsSurface surface, vec3 normal, vec3 plane, vec3 to_eye)
{
  PsLobes lobes;
  lobes.normal = normal;
  lobes.reflecting = ps_reflecting_normal(normal, plane, to_eye);
  float facing = dot(lobes.reflecting, to_eye);
  lobes.to_eye = to_eye;
  lobes.cos_eye = clamp(facing, 1e-4, 1.0);
  lobes.mirror = 2.0 * facing * lobes.reflecting - to_eye;
  lobes.across = cross(lobes.reflecting, to_eye);
  float sine = length(lobes.across);
  lobes.across = sine > 1e-6 ? lobes.across / sine : vec3(0.0);

#ifdef PS_ONE_SURFACE
  vec4 table = ps_table_row(PS_SURFACE_ROW, lobes.cos_eye);
  float reflected = table.x;
  lobes.dielectric_scale = table.y;
  lobes.roughness = table.z;
  lobes.eta = table.w;
#else
  lobes.roughness = clamp(surface.roughness, 0.0, 1.0);
  lobes.eta = surface.eta;
  float root = (surface.eta - 1.0) / (surface.eta + 1.0);
  float f0 = root * root;

  // Single scattering from the table, multiple over single scattering as a factor.
  vec4 table = ps_reflectance_table(lobes.cos_eye, lobes.roughness);
  float missing = (1.0 - table.x) / table.x;
#ifdef PS_TINTED
  lobes.dielectric_f0 = f0 * ps_tint;
  float rise = (ps_mean_fresnel(surface.eta) - f0) / (1.0 - f0);
  vec3 dielectric_mean = mix(lobes.dielectric_f0, vec3(1.0), max(rise, 0.0));
#else
  float dielectric_mean = ps_mean_fresnel(surface.eta);
#endif
  lobes.dielectric_scale = 1.0 + missing * dielectric_mean * table.w / (1.0 - dielectric_mean * (1.0 - table.w));
#ifdef PS_TINTED
  vec3 reflected = mix(lobes.dielectric_f0, vec3(1.0), table.z) * table.x * lobes.dielectric_scale;
  reflected = surface.eta == 1.0 ? vec3(0.0) : reflected;
  lobes.dielectric_scale = surface.eta == 1.0 ? vec3(0.0) : lobes.dielectric_scale;
#else
  float reflected = surface.eta == 1.0 ? 0.0 : mix(f0, 1.0, table.z) * table.x * lobes.dielectric_scale;
#endif
#endif
  lobes.alpha = max(lobes.roughness * lobes.roughness, PS_MIN_ALPHA);
#ifdef PS_TANGENT
  vec3 grain = ps_grain - dot(ps_grain, lobes.reflecting) * lobes.reflecting;
  float grain2 = dot(grain, grain);
  lobes.grain = grain2 > 1e-8 ? grain * inversesqrt(grain2) : vec3(0.0);
  lobes.stretch = grain2 > 1e-8 ? 1.0 / (1.0 - min(length(ps_grain), 0.99)) : 1.0;
  lobes.own2 = lobes.alpha * lobes.alpha;
#endif
#ifdef PS_SPREAD
  // Squares of alpha are twice the variance of slopes along one direction.
  lobes.spread = surface.spread;
  lobes.widened = max(min(surface.spread, 1.0 - lobes.alpha * lobes.alpha), 0.0);
  // The sum of a GGX lobe's slopes and a Gaussian's is drawn as a mixture of both, whose peak is a quarter too high where neither
  // is the wider one, unless that is a little wider than the sum. Of wide lobes, which normals turn more than they add slopes, it is not.
  float own2 = lobes.alpha * lobes.alpha, both2 = own2 + lobes.widened;
  lobes.alpha = min(sqrt(both2 + PS_WIDER_SUM * max(1.0 - PS_TURNED_BY * own2, 0.0) * own2 * lobes.widened / both2), 1.0);
  lobes.roughness = sqrt(lobes.alpha);
#endif
  lobes.reflectance = vec3(reflected);
  lobes.diffuse = max(surface.base, 0.0) * (1.0 - min(ps_most(lobes.reflectance), 1.0));
#ifdef PS_HAS_METAL
  float metallic = clamp(surface.metallic, 0.0, 1.0);
#ifdef PS_GLOSS
  lobes.metal_f0 = clamp(ps_gloss.x < 0.0 ? surface.base : ps_gloss.rgb, 0.0, 1.0);
  lobes.metal_grazing = ps_gloss.w > 0.5 ? lobes.metal_f0 : vec3(1.0);
#else
  lobes.metal_f0 = clamp(surface.base, 0.0, 1.0);
#endif
  vec3 metal_mean = lobes.metal_f0 + (PS_METAL_GRAZING - lobes.metal_f0) / 21.0;
#ifdef PS_TINTED
  lobes.metal_dip = ps_metal_dip(lobes.metal_f0, ps_tint);
  metal_mean -= lobes.metal_dip / 126.0;
#endif
  lobes.metal_scale = metallic * (1.0 + missing * metal_mean * table.w / (1.0 - metal_mean * (1.0 - table.w)));
  vec3 metal_reflected = mix(lobes.metal_f0, PS_METAL_GRAZING, table.y) * table.x;
#ifdef PS_TINTED
  float grazing = pow(table.y, 0.2);
  metal_reflected = max(metal_reflected - lobes.metal_dip * (1.0 - grazing) * table.y * grazing * table.x, 0.0);
#endif
  lobes.reflectance = (1.0 - metallic) * lobes.reflectance + lobes.metal_scale * metal_reflected;
  lobes.dielectric_scale *= 1.0 - metallic;
  lobes.diffuse *= 1.0 - metallic;
#endif
  lobes.reflectance *= facing > 0.0 ? 1.0 : 0.0;
#ifdef PS_LAYERED
  lobes.below = vec3(1.0);
#endif
  ps_keep_lambert(lobes);
  return lobes;
}

#ifdef PS_TERM

// Leaves of the lobes what belongs to the term of light that is shaded.
void ps_keep_term(inout PsLobes lobes)
{
#ifndef PS_SHOWS_DIFFUSE
  lobes.diffuse = vec3(0.0);
#endif
#ifndef PS_SHOWS_GLOSSY
  ps_leave_out_glossy(lobes);
#endif
#if defined(PS_DIFFUSE_LOBES) && !defined(PS_SHOWS_DIFFUSE)
  lobes.even = vec3(0.0);
#ifdef PS_SHEEN
  lobes.fibres = vec3(0.0);
#endif
#endif
}

#endif

#ifdef PS_BACKLIT

PsLobes ps_behind_lobes;  // what light from behind the surface meets

// Moves the share of the diffuse lobe that is lit from behind.
void ps_divide_diffuse(inout PsLobes lobes)
{
  ps_behind_lobes = lobes;
  ps_behind_lobes.normal = -lobes.normal;
  ps_behind_lobes.diffuse *= ps_backlit;
  ps_leave_out_glossy(ps_behind_lobes);
  ps_keep_lambert(ps_behind_lobes);
#ifdef PS_DIFFUSE_LOBES
  lobes.even -= ps_behind_lobes.diffuse;
#endif
  lobes.diffuse *= 1.0 - ps_backlit;
}

#endif

#ifdef PS_COAT

PsLobes ps_coated;  // the coat above what is shaded

// What the coat leaves of all that lies below it, seen from the eye: what it does not reflect, absorbed along the way.
vec3 ps_below_coat(PsLobes coat)
{
  float eta = max(ps_coat.layer.z, 1e-3);
  float inside2 = 1.0 - (1.0 - coat.cos_eye * coat.cos_eye) / (eta * eta);
  float thickness = inversesqrt(max(inside2, 1e-4));
  vec3 passes = mix(vec3(1.0), pow(max(ps_coat.tint, 1e-6), vec3(thickness)), ps_coat.layer.x);
  return passes * (1.0 - min(coat.reflectance, 1.0));
}

PsLobes ps_coat_lobes(vec3 normal, vec3 plane, vec3 to_eye, float spread)
{
#ifdef PS_SPREAD
  PsSurface surface = PsSurface(vec3(0.0), vec3(0.0), ps_coat.layer.y, 0.0, ps_coat.layer.z, spread);
#else
  PsSurface surface = PsSurface(vec3(0.0), vec3(0.0), ps_coat.layer.y, 0.0, ps_coat.layer.z);
#endif
#ifdef PS_TINTED
  ps_tint = vec3(1.0);
#endif
#ifdef PS_GLOSS
  ps_gloss = vec4(-1.0, -1.0, -1.0, 0.0);
#endif
#ifdef PS_TANGENT
  ps_grain = vec3(0.0);
#endif
  PsLobes coat = ps_lobes(surface, normal, plane, to_eye);
  coat.reflectance *= ps_coat.layer.x;
  coat.dielectric_scale *= ps_coat.layer.x;
  return coat;
}

#endif

#ifdef PS_LAYERED

// What is below a layer, of which `left` arrives.
PsLobes ps_covered_lobes(PsLobes lobes, vec3 left)
{
  lobes.diffuse *= left;
  lobes.reflectance *= left;
  lobes.below *= left;
#ifdef PS_DIFFUSE_LOBES
  lobes.even *= left;
#endif
  return lobes;
}

#endif

#include "lib/light/specular.glsl"

#endif
