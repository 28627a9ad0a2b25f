"""Real spherical harmonics of degrees 0 to 4, with the order and the signs of Kerbl et al. 2023, and how they turn.

Their first ones are 0.28, -0.49 y, 0.49 z, -0.49 x: with the Condon-Shortley phase, orders from minus the degree up.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

MOST_DEGREE = 4


def harmonics(direction: np.ndarray, degree: int) -> np.ndarray:
    """Returns the functions of degrees 0 to `degree` of unit vectors (n, 3): (n, (degree + 1)^2) float64."""
    x, y, z = np.asarray(direction, np.float64).T
    xx, yy, zz = x * x, y * y, z * z
    functions = [np.full_like(x, 0.5), -sqrt(3 / 4) * y, sqrt(3 / 4) * z, -sqrt(3 / 4) * x]
    if degree > 1:
        a, b = sqrt(15 / 4), sqrt(5 / 16)
        functions += [a * x * y, -a * y * z, b * (2 * zz - xx - yy), -a * x * z, a / 2 * (xx - yy)]
    if degree > 2:
        a, b, c = sqrt(35 / 32), sqrt(105 / 4), sqrt(21 / 32)
        functions += [-a * y * (3 * xx - yy), b * x * y * z, -c * y * (4 * zz - xx - yy),
                      sqrt(7 / 16) * z * (2 * zz - 3 * xx - 3 * yy), -c * x * (4 * zz - xx - yy),
                      b / 2 * z * (xx - yy), -a * x * (xx - 3 * yy)]  # fmt: skip
    if degree > 3:
        a, b, c, d = sqrt(315 / 16), sqrt(315 / 32), sqrt(45 / 16), sqrt(45 / 32)
        functions += [a * x * y * (xx - yy), -b * y * z * (3 * xx - yy), c * x * y * (7 * zz - 1),
                      -d * y * z * (7 * zz - 3), (35 * zz * zz - 30 * zz + 3) * (3 / 16), -d * x * z * (7 * zz - 3),
                      c / 2 * (xx - yy) * (7 * zz - 1), -b * x * z * (xx - 3 * yy),
                      a / 4 * (xx * (xx - 3 * yy) - yy * (3 * xx - yy))]  # fmt: skip
    return np.stack(functions, axis=1)[:, : (degree + 1) ** 2] / sqrt(pi)


def turning(matrix: np.ndarray, degree: int) -> np.ndarray:
    """Returns the matrix (2 degree + 1,) * 2 that takes a function's coefficients of one degree to those of the
    function turned, or mirrored, by an orthogonal matrix (3, 3): Wigner's, for real harmonics.

    They are what values in some directions ask for: f_turned(d) = f(matrix^T d).
    """
    count = 4 * (2 * degree + 1)
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.arange(count) * pi * (3 - sqrt(5))
    direction = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    own = slice(degree**2, (degree + 1) ** 2)
    turned = harmonics(direction @ np.asarray(matrix, np.float64), degree)[:, own]
    return np.linalg.pinv(harmonics(direction, degree)[:, own]) @ turned
