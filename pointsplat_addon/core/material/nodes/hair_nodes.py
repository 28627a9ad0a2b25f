"""The node that gives hair its colour: Cycles' Principled Hair BSDF, parametrised three ways."""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from ..expression import Expression, SampleInputs
from ..hair_color import LEAST, absorption_from_color, absorption_from_melanin, color_from_absorption


@record
class HairColor(Expression):
    """The colour (N, 3) that hair of some absorption has, whatever the absorption is given by."""

    value: Expression  # ABSORPTION: (N, 3); MELANIN: (N, 1); COLOR: (N, 3)
    redness: Expression
    tint: Expression
    random_color: Expression
    random: Expression
    radial: Expression
    parametrization: str = "COLOR"  # or ABSORPTION, MELANIN

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        value, redness, tint, amount, random, radial = values
        radial = np.clip(radial, 0.001, 1)
        if self.parametrization == "COLOR":
            return np.clip(value[:, :3], LEAST, 1)
        if self.parametrization == "ABSORPTION":
            return color_from_absorption(value[:, :3], radial)
        melanin = value * (1 + 2 * (random - 0.5) * np.clip(amount, 0, 1))
        absorption = absorption_from_melanin(melanin, redness) + absorption_from_color(tint[:, :3], radial)
        return color_from_absorption(absorption, radial)
