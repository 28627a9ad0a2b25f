// The ellipse of a splat in pixels. Reference: tests/reference/opaque.py.

#include "lib/data/splat.glsl"

// A splat is at least this wide, as a standard deviation in pixels, in any direction: disks seen edge-on stay invertible.
#define PS_LEAST_SIGMA 0.02
// Nodes of a coarse cut: those of squares in a plane leave their corners open, and thin ones what lies between them.
#define PS_COARSE_AREA 2.0
#define PS_COARSE_SIGMA 0.5  // pixels
#define PS_ALONE_SIGMA 4.0  // pixels
#define PS_OFF_CENTRE 0x80000000u  // of a depth or an index: the splat does not hold its pixel's centre

// Rows of the matrix that takes offsets in the object to half pixels: the perspective Jacobian (Zwicker et al. 2001)
// times the instance's linear part.
mat2x3 ps_half_pixels(int instance, vec3 p)
{
  mat3 rows = transpose(ps_linear(instance));
  float scale = ps_is_perspective() ? -1.0 / p.z : 1.0;
  vec2 slope = ps_is_perspective() ? p.xy * scale : vec2(0.0);
  return mat2x3(0.5 * scale * u.focal.x * (rows[0] + slope.x * rows[2]),
                0.5 * scale * u.focal.y * (rows[1] + slope.y * rows[2]));
}

// Covariance (xx, xy, yy) of the splat at `p` in view space; its rim lies at 2 sigma. With M from ps_half_pixels, a ball
// has r^2 M M^T, a disk lacks what lies along its normal, and an ellipse has more along its major axis.
vec3 ps_moments(int instance, vec3 p, float normal_code, vec4 extent)
{
  mat2x3 m = ps_half_pixels(instance, p);
  float minor2 = extent.y * extent.y;
  vec3 covariance = minor2 * vec3(dot(m[0], m[0]), dot(m[0], m[1]), dot(m[1], m[1]));
  vec2 along = (normal_code >= 0.0 ? 1.0 : 0.0) * (ps_unpack_normal(max(normal_code, 0.0)) * m);
  covariance -= minor2 * vec3(along.x * along.x, along.x * along.y, along.y * along.y);
#ifdef PS_ELLIPSES
  vec2 major = ps_unpack_normal(extent.z) * m;
  covariance += (extent.x * extent.x - minor2) * vec3(major.x * major.x, major.x * major.y, major.y * major.y);
#endif
  return covariance;
}

// The same, at least PS_LEAST_SIGMA wide in any direction.
vec3 ps_footprint(int instance, vec3 p, float normal_code, vec4 extent)
{
  vec3 covariance = ps_moments(instance, p, normal_code, extent);
  float mean = 0.5 * (covariance.x + covariance.z);
  float least = mean - length(vec2(0.5 * (covariance.x - covariance.z), covariance.y));
  float wider = max(PS_LEAST_SIGMA * PS_LEAST_SIGMA - least, 0.0);
#ifdef PS_DISCONNECTED
  // Of disconnected splats the area counts.
  wider = extent.y < 0.0 ? 0.0 : wider;
#endif
  covariance.xz += wider;
#ifdef PS_COARSE
  covariance *= PS_COARSE_AREA;
  covariance.xz += PS_COARSE_SIGMA * PS_COARSE_SIGMA;
#endif
  return covariance;
}

#ifdef PS_DISCONNECTED
// Whether a splat shows where it covers pixels' centres, and nowhere else: it is disconnected, and is not so wide that to
// fill it from its middle costs less.
bool ps_alone(vec3 covariance, vec4 extent)
{
  return extent.y < 0.0 && max(covariance.x, covariance.z) <= PS_ALONE_SIGMA * PS_ALONE_SIGMA;
}
#endif

// PS_OFF_CENTRE where the ellipse around a centre that is `v` pixels from its pixel's centre does not hold that.
uint ps_off_centre(vec3 c, vec2 v)
{
  float det = max(c.x * c.z - c.y * c.y, 1e-12);
  return c.z * v.x * v.x - 2.0 * c.y * v.x * v.y + c.x * v.y * v.y <= 4.0 * det ? 0u : PS_OFF_CENTRE;
}
