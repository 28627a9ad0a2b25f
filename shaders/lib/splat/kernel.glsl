// The kernel of translucent splats; reference: core/splat/kernel.py.

#ifdef PS_SHORT_KERNEL  // with the same mass and covariance, and a nearer rim
#define PS_SUPPORT 8.0
#define PS_RIM_SIGMA 2.8284271
#else
#define PS_SUPPORT 12.0  // squared Mahalanobis distance of the rim
#define PS_RIM_SIGMA 3.4641016  // its root
#endif
#define PS_PEAK 0.83333333  // of the middle, over that of a Gaussian

// Over the middle's, for squared Mahalanobis distances below PS_SUPPORT.
float ps_kernel(float q)
{
  float t = 1.0 - q / PS_SUPPORT;
#ifdef PS_SHORT_KERNEL
  return 0.9 * t * t;
#else
  return t * t * t * t;
#endif
}

// Share of a Gaussian below x standard deviations, to 3e-4.
float ps_below(float x)
{
  return 1.0 / (1.0 + exp(-1.5957691 * (x + 0.044715 * x * x * x)));
}
