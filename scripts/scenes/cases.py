"""All named cases, each made once in a process."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from scripts.scenes import indirect_cases
from scripts.scenes.awkward_cases import far_away, inside, not_finite, scales
from scripts.scenes.captured_cases import (
    captured_alone,
    captured_among,
    captured_among_panes,
    captured_in_smoke,
    captured_lit,
    captured_matte,
    captured_trained,
)
from scripts.scenes.case import Case
from scripts.scenes.detailed_cases import foliage, many_towers, split_mesh, strands
from scripts.scenes.lit_cases import emission, environment, lights, reflections
from scripts.scenes.solid_cases import (
    balls,
    cube,
    culled,
    empty,
    flowing,
    holdout,
    instances,
    mixed,
    moving,
    parallel,
    parallel_balls,
    plain_sphere,
    region,
    sphere,
    textured,
    unlit,
    waves,
    wide_balls,
)
from scripts.scenes.translucent_cases import (
    in_fog,
    in_smoke,
    panes,
    panes_in_coloured_smoke,
    panes_in_smoke,
    panes_of_functions,
    smoke,
    tinted_panes,
    tinted_smoke,
)

CASES: dict[str, Callable[[], Case]] = {
    function.__name__: cache(function)
    for function in (
        empty,
        cube,
        sphere,
        plain_sphere,
        mixed,
        textured,
        waves,
        instances,
        balls,
        wide_balls,
        parallel_balls,
        emission,
        holdout,
        environment,
        lights,
        reflections,
        *indirect_cases.EVERY,
        inside,
        far_away,
        scales,
        not_finite,
        parallel,
        region,
        unlit,
        moving,
        flowing,
        culled,
        smoke,
        tinted_smoke,
        panes,
        panes_in_smoke,
        panes_in_coloured_smoke,
        panes_of_functions,
        tinted_panes,
        captured_alone,
        captured_among,
        captured_among_panes,
        captured_in_smoke,
        captured_lit,
        captured_matte,
        captured_trained,
        in_fog,
        in_smoke,
        foliage,
        many_towers,
        split_mesh,
        strands,
    )
}
