// Diffuse lobes other than Lambert's, for brdf.glsl: BSDFs times pi, by the direction to the light.
// PS_ROUGH_DIFFUSE: Fujii's improved Oren-Nayar model ("A tiny improvement of Oren-Nayar reflectance model", 2012) with the light
// that is scattered more than once of Portsmouth, Kutz and Hill ("EON: A Practical Energy-Preserving Rough Diffuse BRDF", 2025).
// PS_SHEEN: fibres by Zeltner, Burley and Chiang ("Practical Multiple-Scattering Sheen Using Linearly Transformed Cosines",
// 2022), of whose tables these are MaterialX' rational fits. PS_TOON: Blender's diffuse Toon BSDF.

// The least cosine by which irradiance is divided: that of normals that are seen and of lights with a size is not 0 at the
// horizon, where the middle one's is.
float ps_least_cosine(PsLobes lobes)
{
#ifdef PS_SPREAD
  return max(0.8 * sqrt(0.5 * max(lobes.spread, 0.0)), 0.005);
#else
  return 0.005;
#endif
}

#ifdef PS_ROUGH_DIFFUSE

// Of a surface of roughness 1, what it reflects of uniform light more than Lambert's, by the cosine of the other direction; over pi.
float ps_rough_albedo(float cosine)
{
  if (cosine < 1e-6) {
    return 0.5 * PS_PI - 2.0 / 3.0 - cosine;
  }
  float sine = sqrt(max(1.0 - cosine * cosine, 0.0)), angle = atan(sine, cosine);
  return sine * (angle - 2.0 / 3.0 - sine * cosine) + 2.0 / 3.0 * (sine / cosine) * (1.0 - sine * sine * sine);
}

float ps_rough_scale(float rough)
{
  return 1.0 / (PS_PI + rough * (0.5 * PS_PI - 2.0 / 3.0));
}

void ps_roughen(inout PsLobes lobes, vec3 base, float rough)
{
  rough = clamp(rough, 0.0, 1.0);
  float scale = ps_rough_scale(rough);
  float once = scale * (PS_PI + rough * ps_rough_albedo(max(dot(lobes.normal, lobes.to_eye), 0.0)));
  float mean = scale * (PS_PI + rough * (2.0 * PS_PI - 5.6) / 3.0);
  vec3 color = clamp(base, 0.0, 1.0);
  lobes.rough = rough;
  lobes.again = color * color * (mean / max(1.0 - mean, 1e-6)) / (1.0 - color * (1.0 - mean)) * (1.0 - once);
  lobes.even = lobes.diffuse * (once + lobes.again * (1.0 - mean));
}

vec3 ps_rough_diffuse(PsLobes lobes, vec3 direction)
{
  float cos_light = max(dot(lobes.normal, direction), 0.0), cos_eye = max(dot(lobes.normal, lobes.to_eye), 0.0);
  float across = dot(direction, lobes.to_eye) - cos_light * cos_eye;
  across /= across > 0.0 ? max(max(cos_light, cos_eye), ps_least_cosine(lobes)) : 1.0;
  float scale = ps_rough_scale(lobes.rough);
  float once = scale * (PS_PI + lobes.rough * ps_rough_albedo(cos_light));
  return PS_PI * scale * (1.0 + lobes.rough * across) + lobes.again * (1.0 - once);
}

#endif

#ifdef PS_TOON

// Light of one angle to the normal, and of any below, reflects alike.
float ps_toon_diffuse(PsLobes lobes, vec3 direction)
{
  float cosine = dot(lobes.normal, direction);
  vec3 across = cross(lobes.normal, direction);
  float angle = atan(length(across), cosine);
  float size = 0.5 * PS_PI * lobes.toon.x, smoothness = 0.5 * PS_PI * lobes.toon.y;
  float all = 1.0 - cos(min(size + smoothness, 0.5 * PS_PI));
#ifdef PS_SPREAD
  // Over as many normals as are seen.
  float range = 1.6 * sqrt(0.5 * max(lobes.spread, 1e-12));
#else
  float range = 1e-6;
#endif
  size -= max(range - 0.5 * smoothness, 0.0);
  float shown = clamp(1.0 - (angle - size) / max(smoothness, 2.0 * range), 0.0, 1.0);
  return cosine > 0.0 ? shown * 0.5 / (all * max(cosine, ps_least_cosine(lobes))) : 0.0;
}

#endif

#ifdef PS_SHEEN

// What fibres reflect of uniform light, and the two numbers of the matrix that makes their lobe a cosine's.
void ps_clothe(inout PsLobes lobes, vec3 color, float rough)
{
  float x = clamp(dot(lobes.normal, lobes.to_eye), 0.0, 1.0), y = clamp(rough, 0.01, 1.0);
  float width = y * (0.0206607 + 1.58491 * y) / (0.0379424 + y * (1.32227 + y));
  float middle = y * (-0.193854 + y * (-1.14885 + y * (1.7932 - 0.95943 * y * y))) / (0.046391 + y);
  float floor_ = y * (0.000654023 + (-0.0207818 + 0.119681 * y) * y) / (1.26264 + y * (-1.92021 + y));
  float away = (x - middle) / width;
  lobes.fibres = color * clamp(exp(-0.5 * away * away) / (width * sqrt(2.0 * PS_PI)) + floor_, 0.0, 1.0);
  lobes.bend.x = (2.58126 * x + 0.813703 * y) * y / (1.0 + 0.310327 * x * x + 2.60994 * x * y);
  lobes.bend.y = sqrt(1.0 - x) * (y - 1.0) * y * y * y / (0.0000254053 + 1.71228 * x - 1.71506 * x * y + 1.34174 * y * y);
}

vec3 ps_fibres(PsLobes lobes, vec3 direction)
{
  float z = dot(lobes.normal, direction);
  vec3 out_of = lobes.to_eye - dot(lobes.normal, lobes.to_eye) * lobes.normal;
  float size = length(out_of);
  float x = size > 1e-6 ? dot(out_of, direction) / size : 0.0;
  float y2 = max(1.0 - z * z - x * x, 0.0), a2 = lobes.bend.x * lobes.bend.x;
  float bent = lobes.bend.x * x + lobes.bend.y * z, length2 = bent * bent + a2 * y2 + z * z;
  return z > 0.0 ? lobes.fibres * (a2 / (length2 * length2)) : vec3(0.0);
}

#endif

// All diffuse lobes: what a surface reflects of light from a direction, over its irradiance, times pi.
vec3 ps_shaped(PsLobes lobes, vec3 direction)
{
  vec3 diffuse = lobes.diffuse;
#ifdef PS_ROUGH_DIFFUSE
  diffuse *= lobes.rough > 0.0 ? ps_rough_diffuse(lobes, direction) : vec3(1.0);
#endif
#ifdef PS_TOON
  diffuse *= lobes.toon.z > 0.5 ? ps_toon_diffuse(lobes, direction) : 1.0;
#endif
#ifdef PS_SHEEN
  diffuse += ps_fibres(lobes, direction);
#endif
  return diffuse;
}
