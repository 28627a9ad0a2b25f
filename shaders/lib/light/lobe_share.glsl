// Common to all kinds of lights: irradiance and reflection, quadratures over shapes, shares of lobes. For lights.glsl.

#define PS_ELLIPSE_SIDES 24
#define PS_SPREAD_CELLS 8
#define PS_BLUR 0.06
#define PS_NARROW_LOW 1.5
#define PS_NARROW_HIGH 4.0
#define PS_AREA_NARROW_LOW 1.0
#define PS_AREA_NARROW_HIGH 2.5
#define PS_SMALL 0.2  // of the lobe's alpha: the angular radius of a light that is a point to it

#ifdef PS_HAS_LIGHTS

// What one light does to one surface point, per unit of its colour.
struct PsReceived {
  float irradiance;
  vec3 specular;  // radiance of the GGX lobe
#ifdef PS_DIFFUSE_LOBES
  vec3 diffuse;  // mean of the diffuse lobes' BSDF over the irradiance, times pi
#endif
};

// `from`: unit, where the irradiance comes from.
PsReceived ps_received(float irradiance, vec3 specular, PsLobes lobes, vec3 from)
{
#ifdef PS_DIFFUSE_LOBES
  return PsReceived(irradiance, specular, ps_shaped(lobes, from));
#else
  return PsReceived(irradiance, specular);
#endif
}

// Radiance that the surface reflects; the light's colour and position texels hold its factors.
vec3 ps_reflected(PsReceived received, PsLobes lobes, vec4 color, float specular)
{
#ifdef PS_DIFFUSE_LOBES
  vec3 diffuse = received.irradiance > 0.0 ? received.diffuse : vec3(0.0);
#else
  vec3 diffuse = lobes.diffuse;
#endif
  return color.rgb * (color.w * received.irradiance / PS_PI * diffuse + specular * received.specular);
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

// alpha^2 of the lobe, widened by the part of the light that each point of a quadrature stands for.
float ps_widened_alpha2(PsLobes lobes, float sigma)
{
  float a2 = lobes.alpha * lobes.alpha;
  return ps_is_small(lobes, sigma) ? a2 : min(a2 + PS_BLUR * sigma * sigma, 1.0);
}

#endif
