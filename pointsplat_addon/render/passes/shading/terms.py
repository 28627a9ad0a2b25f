"""The terms of light that passes of light are made of: which part of what reaches the eye is drawn."""

from __future__ import annotations

import numpy as np

from ....core.numeric.record import value_record

DIFFUSE, GLOSSY, TRANSMISSION = "DIFFUSE", "GLOSSY", "TRANSMISSION"
VOLUME, EMISSION, ENVIRONMENT = "VOLUME", "EMISSION", "ENVIRONMENT"
OCCLUSION = "OCCLUSION"  # no part of Combined: the light that surfaces would receive of a white world alone


@value_record
class Term:
    """One term of a picture: Combined is the sum of all but OCCLUSION, where none of them is a colour.

    What hides something hides it in each term: terms differ in radiance only.
    """

    light: str  # how light leaves what the eye sees: one of the names above; TRANSMISSION: only its colour
    color: bool = False  # how much of it would leave under light that is 1 everywhere; else the radiance
    through: bool = True  # seen through glass, too; else only through what alpha leaves open
    within: float = np.inf  # of OCCLUSION: how far away things may be that hide the world

    @property
    def defines(self) -> tuple[str, ...]:
        """Names of shader defines."""
        named = {"PS_TERM": True, f"PS_TERM_{self.light}": True, "PS_TERM_COLOR": self.color}
        return tuple(name for name, on in named.items() if on)

    @property
    def lit(self) -> bool:
        """Whether lamps matter to it."""
        return not self.color and self.light not in (EMISSION, ENVIRONMENT, OCCLUSION)

    @property
    def gathers(self) -> bool:
        """Whether light matters to it that surfaces receive from each other."""
        return not self.color and self.light in (DIFFUSE, GLOSSY, OCCLUSION)
