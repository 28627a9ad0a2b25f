// The kernel of translucent splats; reference: core/splat/kernel.py.

#define PS_SUPPORT 12.0  // squared Mahalanobis distance of the rim
#define PS_RIM_SIGMA 3.4641016  // its root
#define PS_PEAK 0.83333333  // of the middle, over that of a Gaussian

// Over the middle's, for squared Mahalanobis distances below PS_SUPPORT.
float ps_kernel(float q)
{
  float t = 1.0 - q / PS_SUPPORT;
  return t * t * t * t;
}

// Share of a Gaussian below x standard deviations, to 3e-4.
float ps_below(float x)
{
  return 1.0 / (1.0 + exp(-1.5957691 * (x + 0.044715 * x * x * x)));
}
