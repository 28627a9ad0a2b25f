// What a pixel of the G-buffer and of its pyramid knows: one splat, or a mean of several.
//   centre   depth d; offset of the splat's centre from the pixel's, in pixels of the picture; half extent in depth:
//           0 empty, PS_POLYGON a polygon (extends over its own pixel only), > 0 a splat, < 0 a splat beside the
//           pixel's centre, which only its neighbours and coarser levels know
//           Of what is no splat, see surfel_kind.glsl
//   shape   Cholesky factor l11, l21, l22 of the splat's covariance in pixels^2, and its material (-1 - m: a holdout;
//           PS_MATTE: a matte).
//           A uniform disk of radius r has the variance r^2 / 4: the splat's rim lies at 2 sigma
//   normal  in view space, of the side of the surface's plane that is seen (it may point away from the eye where it is not
//           the plane's), (0, 0, 0) for a ball; roughness
//   color   base colour, metallic
//   tangent  in view space, along which the GGX lobe is stretched: core/material/nodes/normal_nodes.py
// PS_NORMAL: something shines, or a pass asks. PS_COLOR: colours come with the points; else the material table has
// them; so do PS_SURFACE roughness and metallic, and PS_EMISSION. PS_OWNER: which instance, for passes that ask.
// PS_VELOCITY: how far the point moves in a frame, in view space, in one texture with its instance (-1: none).

#include "lib/geometry/surfel_kind.glsl"

struct PsSurfel {
  vec4 centre;
  vec4 shape;
#ifdef PS_NORMAL
  vec4 normal;
#endif
#ifdef PS_COLOR
  vec4 color;
#endif
#ifdef PS_EMISSION
  vec4 emission;
#endif
#ifdef PS_TANGENT
  vec4 tangent;
#endif
#ifdef PS_OWNER
  uint owner;
#endif
#ifdef PS_VELOCITY
  vec3 velocity;
#endif
};

#define PS_RIM 4.0  // squared Mahalanobis distance of a splat's rim: 2 sigma

PsSurfel ps_empty()
{
  PsSurfel s;
  s.centre = vec4(0.0);
  s.shape = vec4(0.0);
#ifdef PS_NORMAL
  s.normal = vec4(0.0);
#endif
#ifdef PS_COLOR
  s.color = vec4(0.0);
#endif
#ifdef PS_EMISSION
  s.emission = vec4(0.0);
#endif
#ifdef PS_TANGENT
  s.tangent = vec4(0.0);
#endif
#ifdef PS_OWNER
  s.owner = 0xFFFFFFFFu;
#endif
#ifdef PS_VELOCITY
  s.velocity = vec3(0.0);
#endif
  return s;
}

vec3 ps_covariance(vec3 l)
{
  return vec3(l.x * l.x, l.x * l.y, l.y * l.y + l.z * l.z);
}

vec3 ps_cholesky(vec3 c)
{
  float l11 = sqrt(max(c.x, 1e-12));
  float l21 = c.y / l11;
  return vec3(l11, l21, sqrt(max(c.z - l21 * l21, 1e-12)));
}
