// The resampling kernel of EWA splatting (Zwicker et al. 2001): a Gaussian whose covariance is the splat's on the screen
// plus the low-pass of a pixel. Reference: core/splat/ewa.py.

#define PS_EWA_CUTOFF 5.0  // squared Mahalanobis distance at which kernels end
#define PS_EWA_CUTOFF_SIGMA 2.2360680  // its root
#define PS_EWA_KEPT 0.91791500  // 1 - exp(-c) with c = PS_EWA_CUTOFF / 2: what the cut leaves of a Gaussian's mass
// Of its ellipse's area a splat stands for the cell that the ellipse goes around: between 1 / pi, half a rectangle, and
// 2 / pi, a rectangle (core/surface/sampling.py). Where an ellipse holds the pixel's centre, the lower sums count as much as the
// higher ones, so that no surface lets through what is behind; beside it, they are taken as they are, or, with many samples
// (PS_HARD), not at all: the sums within make up for that, too.
#define PS_EWA_SHARE 0.45015816  // the mean of the two, sqrt(2) / pi
#ifdef PS_HARD
#define PS_EWA_WITHIN 1.8
#else
#define PS_EWA_WITHIN 1.4142136
#endif
// A node stands for nearly all of its ellipse, 3 / pi for a square: its moments are those of what it holds, and reach less
// far than the corners of that. Its rim, where it hides what is behind it, goes around them.
#define PS_EWA_NODE_SHARE 0.95492966

// Squared Mahalanobis distance of the rim of a splat that stands for this share of its ellipse; 1: it stands alone.
float ps_ewa_rim(float share)
{
  return share == PS_EWA_NODE_SHARE ? 6.0 : 4.0;
}

// Closed surfaces end with their front and their back at the same edge, where only the front is to be seen: what shows its
// back weighs less by this factor, where nothing or a front is nearest.
#define PS_EWA_BACK 0.015625

#define PS_EWA_STEEP 3.0  // pixels of depth that a plane falls within one, from which on it is seen nearly edge-on

// Whether the nearest surface of a pixel, as the pass `visibility` left it, shows its back.
bool ps_back_seen(vec4 nearest)
{
  return nearest.x > 0.0 && (int(nearest.w) & 1) == 1;
}

// The least variance that an ellipse keeps across, in pixels^2, and in shares of the mean variance, which float32 needs:
// disks seen edge-on stay invertible, and hardly wider than they are.
#define PS_EWA_LEAST 2e-5
#define PS_EWA_THINNEST 3e-6

// The kernel's middle, for the determinants of the covariance with and without the low-pass: the pixels that the splat
// stands for, 4 pi share sqrt(of), over the integral of what the cut leaves of the Gaussian, 2 pi kept sqrt(with).
float ps_ewa_peak(float share, float of, float with)
{
  return 2.0 * share / PS_EWA_KEPT * sqrt(max(of, 0.0) / with);
}
