"""Spectra of 21 wavelengths as colours, and the sun's."""

from __future__ import annotations

import numpy as np

WAVELENGTHS = np.arange(380.0, 781.0, 20.0)  # nanometres
STEP = 20.0  # nanometres
# The CIE 1931 standard observer of 2 degrees at WAVELENGTHS (CIE 15:2004, table T.4), (21, 3)
OBSERVER = np.array([
    [0.001368, 0.000039, 0.006450], [0.014310, 0.000396, 0.067850], [0.134380, 0.004000, 0.645600],
    [0.348280, 0.023000, 1.747060], [0.290800, 0.060000, 1.669200], [0.095640, 0.139020, 0.812950],
    [0.004900, 0.323000, 0.272000], [0.063270, 0.710000, 0.078250], [0.290400, 0.954000, 0.020300],
    [0.594500, 0.995000, 0.003900], [0.916300, 0.870000, 0.001650], [1.062200, 0.631000, 0.000800],
    [0.854450, 0.381000, 0.000190], [0.447900, 0.175000, 0.000020], [0.164900, 0.061000, 0.000000],
    [0.046770, 0.017000, 0.000000], [0.011359, 0.004102, 0.000000], [0.002899, 0.001047, 0.000000],
    [0.000690, 0.000249, 0.000000], [0.000166, 0.000060, 0.000000], [0.000042, 0.000015, 0.000000],
])  # fmt: skip
RGB_FROM_XYZ = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)  # linear Rec. 709, D65
SUN_KELVIN = 5772.0  # effective temperature of the sun (IAU 2015 Resolution B3)
SUN_SOLID_ANGLE = 6.807e-5  # steradian, mean over the year
PLANCK = 1.191042972e20, 1.438776877e7  # 2 h c^2 in W nm^4 / m^2 per nm and sr; h c / k in nm K


def sun_irradiance() -> np.ndarray:
    """The sun's irradiance outside the atmosphere, (21,) W/m2 per nanometre: a black body's."""
    first, second = PLANCK
    return SUN_SOLID_ANGLE * first / (WAVELENGTHS**5 * np.expm1(second / (WAVELENGTHS * SUN_KELVIN)))
