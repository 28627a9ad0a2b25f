"""Depth of field by splat convolution (Křivánek 2003, chapter 5), in float64: what shaders/defocus/gather.frag is measured
against, and which nodes its cut needs.

A point at depth d is seen as the disk of confusion, whose radius in pixels is (equations 6 to 8)

    C(d) = f r |1/d - 1/D|,                 of parallel cameras    C(d) = f r |1 - d/D|,

f: pixels per unit at depth 1, r: radius of the aperture, D: distance of the plane of focus. A splat is that disk
convolved with its own footprint. Křivánek takes a Gaussian for both, of as much variance as holds half its energy in
the same radius; it reaches 1.8 times as far as the disk does, and no highlight is a disk. Here

    K(q) = (k + 1) / (pi S sqrt(det M)) (1 - q / S)^k,    S = 2 (k + 2),    q = v^T M^-1 v,

whose integral is one and whose covariance is M = J V J^T + p I + C^2/4 I for every k: the splat's own, the pixel's and
the disk's. k = 0 is the disk itself. k is chosen such that the fourth moment, too, is that of the convolution: with b
the disk's share of the variance, k = 3 (1 - b^2) / b^2, at most that of core/splat/kernel.py, which stands for a Gaussian;
SMOOTHER times that where neighbours add up to a surface.

A splat that leans is seen larger from one side of the lens than from the other, so that the middle of its kernel lies
beside its place (`lean`): otherwise what curves away ends too early or too late.

What is blurred by less than IN_FOCUS pixels is drawn as without depth of field, what is blurred by more than BLURRED
by such splats, and between the two a part by each: `sharp`.
"""

from __future__ import annotations

NEGLIGIBLE = 1e-3  # of a kernel's middle, and of the lens: where splats end
SOFT_RIM = 0.002  # of 1 - q / S: where the rim is drawn softer than it is
