// The GGX lobe by the direction of the light, for brdf.glsl.

#ifdef PS_TANGENT

// Squares of alpha along the grain, across it, and of 1 along the normal, of a lobe of which a2 is the mean one.
vec3 ps_stretched(PsLobes lobes, float a2)
{
  float more = a2 - lobes.own2, stretch2 = lobes.stretch * lobes.stretch;
  return vec3(max(vec2(lobes.own2 * stretch2, lobes.own2 / stretch2) + more, vec2(1e-6)), 1.0);
}

// Squares of the components of a vector along the grain, across it, and along the normal.
vec3 ps_parts2(PsLobes lobes, vec3 v)
{
  float along = dot(v, lobes.grain), up = dot(v, lobes.reflecting);
  float across = dot(v, cross(lobes.reflecting, lobes.grain));
  return lobes.stretch == 1.0 ? vec3(max(dot(v, v) - up * up, 0.0), 0.0, up * up) :
                                vec3(along * along, across * across, up * up);
}

#endif

// Angle by which reflected rays turn along a unit direction where the half vector's slope is alpha, per unit of length
// along `direction` at unit distance.
float ps_width_along(PsLobes lobes, vec3 direction)
{
  vec3 seen = direction - dot(direction, lobes.mirror) * lobes.mirror;
  float size2 = max(dot(seen, seen), 1e-6);
  float across = dot(seen, lobes.across);
#ifdef PS_TANGENT
  vec3 parts = ps_parts2(lobes, seen);
  vec2 turned = ps_stretched(lobes, lobes.alpha * lobes.alpha).xy;
  float alpha = sqrt(dot(parts.xy, turned) / max(parts.x + parts.y, 1e-9));
#else
  float alpha = lobes.alpha;
#endif
  return 2.0 * alpha * sqrt((1.0 - across * across / size2 * (1.0 - lobes.cos_eye * lobes.cos_eye)) / size2);
}

// The part of alpha squared that is the material's own: normals that are seen do not mask each other.
float ps_own_alpha2(PsLobes lobes, float a2)
{
#ifdef PS_SPREAD
  return a2 - lobes.widened;
#else
  return a2;
#endif
}

// 2 n.l n.v over the share of both directions that is not masked, which correlate (Heitz 2014, equation 99). `above`, `eye`: cosines
// of the light and the eye to the normal. `rough2`: alpha squared.
float ps_masked(float above, float eye, float rough2)
{
  return above * sqrt(rough2 + (1.0 - rough2) * eye * eye) + eye * sqrt(rough2 + (1.0 - rough2) * above * above);
}

float ps_masked(PsLobes lobes, vec3 direction, float above, float rough2)
{
#ifdef PS_TANGENT
  vec3 alpha2 = ps_stretched(lobes, rough2);
  return above * sqrt(dot(alpha2, ps_parts2(lobes, lobes.to_eye))) +
         lobes.cos_eye * sqrt(dot(alpha2, ps_parts2(lobes, direction)));
#else
  return ps_masked(above, lobes.cos_eye, rough2);
#endif
}

#ifdef PS_SPREAD
// n.l over ps_masked and the cosine to the mean normal, of those normals among the spread that mirror the eye to the light: the mean
// of a Gaussian of slopes, of which the half vector's is the sum with one of the material's own lobe. `along`: n.h; `share`: of the
// spread among both variances. The pixel shows normals by their share of it, as their slopes do, and not by that of a rough
// surface seen from aside: a mean normal's cosines made low highlights up to four times too bright.
float ps_spread_weight(PsLobes lobes, vec3 direction, vec3 h, float along, float share, float rough2)
{
  vec3 n = lobes.reflecting + share * (h / max(along, 1e-6) - lobes.reflecting);
  float cosine = inversesqrt(dot(n, n));
  float above = dot(n, direction) * cosine, eye = max(dot(n, lobes.to_eye) * cosine, 1e-4);
  return along > 0.0 && above > 0.0 ? cosine * above / ps_masked(above, eye, rough2) : 0.0;
}
#endif

// Reflectance of what the half vector stands on, times the lobe's multiple scattering.
vec3 ps_fresnel(PsLobes lobes, float cos_between)
{
#ifdef PS_TINTED
  float root = (lobes.eta - 1.0) / (lobes.eta + 1.0), f0 = root * root;
  float rise = (ps_fresnel_dielectric(cos_between, lobes.eta) - f0) / (1.0 - f0);
  vec3 reflected = lobes.dielectric_scale * mix(lobes.dielectric_f0, vec3(1.0), clamp(rise, 0.0, 1.0));
#else
  vec3 reflected = vec3(lobes.dielectric_scale * ps_fresnel_dielectric(cos_between, lobes.eta));
#endif
#ifdef PS_HAS_METAL
  float x = 1.0 - cos_between, x2 = x * x;
#ifdef PS_TINTED
  vec3 of_metal = lobes.metal_f0 + (PS_METAL_GRAZING - lobes.metal_f0) * (x2 * x2 * x) - lobes.metal_dip * (cos_between * x2 * x2 * x2);
  reflected += lobes.metal_scale * clamp(of_metal, 0.0, 1.0);
#else
  reflected += lobes.metal_scale * (lobes.metal_f0 + (PS_METAL_GRAZING - lobes.metal_f0) * (x2 * x2 * x));
#endif
#endif
#ifdef PS_LAYERED
  reflected *= lobes.below;
#endif
  return reflected;
}

// What BSDF times n.l is for each share of the lobe's half vectors, by a direction to the light.
vec3 ps_half_weight(PsLobes lobes, vec3 direction)
{
  vec3 h = direction + lobes.to_eye;
  float above = max(dot(lobes.reflecting, direction), 0.0), h2 = dot(h, h);
  float masked = ps_masked(lobes, direction, above, ps_own_alpha2(lobes, lobes.alpha * lobes.alpha));
  // v.h / n.h: the length of h cancels.
  float along = dot(lobes.reflecting, h), turned = 0.5 * h2 / max(along, 1e-6);
  float weight = above > 0.0 ? above / masked : 0.0;
#ifdef PS_SPREAD
  float a2 = lobes.alpha * lobes.alpha, share = lobes.widened / a2;
  weight = mix(weight, ps_spread_weight(lobes, direction, h, along, share, ps_own_alpha2(lobes, a2)), share);
#endif
  return ps_fresnel(lobes, min(0.5 * sqrt(h2), 1.0)) * (2.0 * turned * weight);
}

// BSDF of the GGX lobe times n.l, where the lobe may be widened: a2 is its alpha squared. The half vector is left
// unnormalised, h = direction + to_eye, and its length cancels.
vec3 ps_specular(PsLobes lobes, vec3 direction, float a2)
{
  float cos_light = dot(lobes.reflecting, direction);
  float above = max(cos_light, 1e-6);
  vec3 h = direction + lobes.to_eye;
  float h2 = dot(h, h);
  float along = dot(lobes.reflecting, h);
  // |n x h|^2 in place of 1 - (n.h)^2, which cancels.
  vec3 sine = cross(lobes.reflecting, h);
  float spread = a2 * along * along + dot(sine, sine);
  float cos_between = min(0.5 * sqrt(h2), 1.0);
  float masked = ps_masked(lobes, direction, above, ps_own_alpha2(lobes, a2));
#ifdef PS_TANGENT
  vec3 alpha2 = ps_stretched(lobes, a2), parts = ps_parts2(lobes, h);
  float narrow = dot(parts, 1.0 / alpha2);
  float mean2 = sqrt(alpha2.x * alpha2.y);
  float density = 1.0 / (mean2 * narrow * narrow);
#else
  float mean2 = a2;
  float density = a2 / (spread * spread);
#endif
  bool lit = cos_light > 0.0 && dot(lobes.normal, direction) > 0.0 && dot(lobes.reflecting, lobes.to_eye) > 0.0;
  float lobe = lit ? density * above / masked : 0.0;
#ifdef PS_SPREAD
  // Normals that are seen have no tails as those of a GGX lobe.
  float share = min(lobes.widened / mean2, 1.0);
  float along2 = along > 0.0 ? along * along : 1e-9;
#ifdef PS_TANGENT
  float exponent = dot(parts.xy / alpha2.xy, vec2(1.0)) / along2;
#else
  float exponent = dot(sine, sine) / along2 / a2;
#endif
  float gaussian = exp(-exponent) / (mean2 * along2 * along2);
  lobe = mix(lobe, gaussian * ps_spread_weight(lobes, direction, h, along, share, ps_own_alpha2(lobes, a2)), share);
#endif
  return lobe > 0.0 ? lobe * h2 * h2 / (2.0 * PS_PI) * ps_fresnel(lobes, cos_between) : vec3(0.0);
}
