"""The kernel of splats that are out of focus: depth of field by splat convolution (Křivánek 2003, chapter 5).

shaders/defocus/gather.frag draws it; tests/reference/defocus.py computes it in float64.

A point at depth d is seen as its disk of confusion, whose radius in pixels is (equations 6 to 8)

    C(d) = f r |1/d - 1/D|,                 of parallel cameras    C(d) = f r |1 - d/D|,

f: pixels per unit at depth 1, r: radius of the aperture, D: distance of the plane of focus. A splat is that disk
convolved with its own footprint. Křivánek takes Gaussians for both, with half their
energy within the same radius; they extend 1.8 times as far as the disk, and highlights are not disks. Here

    K(q) = (k + 1) / (pi S sqrt(det M)) (1 - q / S)^k,    S = 2 (k + 2),    q = v^T M^-1 v,

whose integral is one and whose covariance is M = J V J^T + p I + C^2/4 I for every k: the splat's own, the pixel's and
the disk's. k = 0 is the disk itself. k is chosen such that the fourth moment, too, is that of the convolution: with b
the disk's share of the variance, k = 3 (1 - b^2) / b^2, at most that of core/splat/kernel.py, which approximates a
Gaussian; twice that where neighbours add up to a surface.

A tilted splat looks larger from one side of the lens than from the other, so that the centre of its kernel is shifted
(`lens_mean` in the reference): without the shift curved surfaces end too early or too late at their silhouettes.

Splats blurred by less than IN_FOCUS pixels are drawn as without depth of field, those blurred by more than
OUT_OF_FOCUS with this kernel, and between the two partly each way (`in_focus_share` in the reference).
"""

from __future__ import annotations

NEGLIGIBLE = 1e-3  # of a kernel's peak, and of the lens: fainter parts are not drawn
SOFT_RIM = 0.002  # of 1 - q / S: a softer rim than the kernel has is drawn below it
