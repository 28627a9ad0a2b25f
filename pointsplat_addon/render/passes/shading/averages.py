"""The passes beyond Combined that are averaged over samples, and where shaders write them."""

from __future__ import annotations

from ..outputs import BY_KEY

AVERAGED = {"normal": ("PS_OUT_NORMAL", "out_normal_pass"), "mist": ("PS_OUT_MIST", "out_mist")}


def averaged(passes: frozenset[str]) -> tuple[str, ...]:
    """Returns the passes that have an accumulator beside Combined."""
    return tuple(key for key in AVERAGED if key in passes and BY_KEY[key].averaged)


def averaged_outputs(passes: frozenset[str], combined: bool) -> tuple[tuple[str, str], ...]:
    first = (("vec4", "out_combined"),) if combined else ()
    return (*first, *(("vec4", AVERAGED[key][1]) for key in averaged(passes)))


def averaged_defines(passes: frozenset[str]) -> tuple[str, ...]:
    return tuple(AVERAGED[key][0] for key in averaged(passes))
