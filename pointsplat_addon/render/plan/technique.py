"""Which technique draws the opaque points of a view, where the person leaves it to us (docs/notes/techniques.md)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...core.scene.materials import MaterialTable
from ...core.scene.scene import Geometry, Scene
from ...core.scene.settings import Settings
from ...core.splat.ewa import centres_decide
from ...core.surface.appearance import graphs_of
from ..prepare.layers import MANY_INSTANCES
from ..prepare.prepare import Prepared


class Technique(NamedTuple):
    """What draws opaque points."""

    name: str  # one of TECHNIQUES, but not AUTO
    because: str


NAMES = {"EWA": "EWA", "PAINTER": "The painter"}  # those that need float_blend
ASKED = "the settings say so"
NO_BLENDING = "this GPU cannot blend floats"
DISCONNECTED = Technique("IMAGE_SPACE", "light passes between disconnected points")


def choose(settings: Settings, scene: Scene, samples: int, interactive: bool, float_blend: bool) -> Technique:
    """The technique that is asked for; for AUTO the nearest to polygons that is worth its time: EWA, from as many
    `samples` as it needs, where it has colours to take means of. `float_blend`: whether the device has what EWA and the
    painter need."""
    if settings.technique != "AUTO":
        found = Technique(settings.technique, ASKED)
    elif interactive:
        found = Technique("IMAGE_SPACE", "views that move need the fastest")
    elif not centres_decide(samples):
        found = Technique("IMAGE_SPACE", "it is the nearest with few samples")
    elif np.bincount(scene.instances.geometry, minlength=1).max() >= MANY_INSTANCES:
        found = Technique("IMAGE_SPACE", "many instances share nodes")
    elif any(_colored(geometry, scene.materials) for geometry in scene.geometries):
        found = Technique("EWA", "colours vary from point to point")
    else:
        found = Technique("IMAGE_SPACE", "no point has a colour of its own")
    return found if found.name not in NAMES or float_blend else Technique("IMAGE_SPACE", NO_BLENDING)


def reconsidered(found: Technique, prepared: Prepared) -> Technique:
    """The technique, now that it is known which points are disconnected (foliage)."""
    foliage = any(points.cloud.disconnected is not None for points in prepared.point_sets.values())
    return DISCONNECTED if foliage and found.name == "EWA" and found.because != ASKED else found


def _colored(geometry: Geometry, table: MaterialTable) -> bool:
    """Whether opaque points of a geometry have colours of their own."""
    if (cloud := geometry.cloud) is not None:
        opaque = cloud.opacity is None and cloud.extinction is None
        return opaque and (cloud.color is not None or cloud.emission is not None)
    if geometry.mesh is None or geometry.primitive == "POLYGONS":
        return False
    channels = {name for graph in graphs_of(geometry.mesh, table).values() for name in graph.channels}
    return bool(channels & {"base_color", "emission"})
