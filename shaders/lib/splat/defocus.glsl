// Disks of confusion, and the kernel of splats that are out of focus. Model: core/lens/kernel.py; reference: tests/reference/defocus.py.
// u.confusion_scale, u.inverse_focus_distance, u.aperture_aspect: render/passes/uniforms.py, LENS_FIELDS.

#define PS_IN_FOCUS 0.3  // pixels of radius
#define PS_BLURRED 0.45
#define PS_NEAREST 1e-9  // of the distance of focus
#define PS_DEFOCUS_FAINT 1e-3  // of a kernel's middle, and of the lens: where splats end
#define PS_DEFOCUS_PIXEL 0.11  // pixels^2 of variance
#define PS_DEFOCUS_MOST 4.0  // exponent of what is hardly blurred: core/splat/kernel.py
#define PS_DEFOCUS_SMOOTHER 2.0
// Added to the exponent: what shows its back, what is translucent, what only hides, what
// belongs to no surface: leaves and hair.
#define PS_DEFOCUS_BACK 8.0
#define PS_DEFOCUS_TRANSLUCENT 16.0
#define PS_DEFOCUS_HOLDOUT 32.0
#define PS_DEFOCUS_DISCONNECTED 64.0

// Radius in pixels, along the picture's y, of the disk of confusion at depth d.
float ps_confusion(float d)
{
  float relative = d * u.inverse_focus_distance;
  return u.confusion_scale * abs(ps_is_perspective() ? 1.0 - 1.0 / max(relative, PS_NEAREST) : relative - 1.0);
}

// Where, in half-axes of the disk about a splat at p with the normal n (view space, of either length), the middle of its
// kernel lies. Reference: tests/reference/defocus.py, `lens_mean`.
vec2 ps_lean(vec3 p, vec3 n)
{
  float lens = u.confusion_scale / u.focal.y;  // radius of the lens over the distance of focus, or the radius itself
  float facing = ps_is_perspective() ? -dot(n, p) * u.inverse_focus_distance : n.z / u.inverse_focus_distance;
  vec2 slope = lens * vec2(u.aperture_aspect, 1.0) * n.xy * (facing < 0.0 ? -1.0 : 1.0);
  return 0.25 * slope / max(max(abs(facing), length(slope)), 1e-30);
}

// How much of what has a disk of this radius is drawn as if it were in focus.
float ps_sharp(float radius)
{
  return 1.0 - smoothstep(PS_IN_FOCUS, PS_BLURRED, radius);
}

// For the disk's share of the variance; of what adds up with its neighbours to a surface, so many times as large.
float ps_defocus_exponent(float share, bool beside)
{
  float square = max(share * share, 1e-6);
  return min((beside ? PS_DEFOCUS_SMOOTHER : 1.0) * 3.0 * (1.0 - square) / square, PS_DEFOCUS_MOST);
}

// The kernel's value in its middle, per pixel^2, for the determinant of its covariance.
float ps_defocus_peak(float k, float det)
{
  return (k + 1.0) / (6.2831853 * (k + 2.0) * sqrt(det));
}
