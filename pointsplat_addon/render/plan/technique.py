"""Decides which technique draws the opaque points of a view (docs/notes/techniques.md).

`decide_technique` decides before a view is prepared, for all that is known of the scene then; how points are prepared
depends on it. `confirm_technique` decides for good: only preparing tells whether points are disconnected and whether
something is out of focus. Nothing else chooses a technique.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.numeric.record import record, value_record
from ...core.scene.materials import MaterialTable
from ...core.scene.scene import Geometry, Scene
from ...core.scene.settings import Settings
from ...core.splat.ewa import centres_decide
from ...core.surface.appearance import graphs_of
from ..prepare.layers import MANY_INSTANCES, MOST_PRIMITIVES
from ..prepare.prepare import Prepared
from ..prepare.separation import is_translucent

MOST_SURFELS_AT_ONCE = 1 << 22  # points on surfaces in a view that moves: with more, nodes of them are faster
TITLES = {"EWA": "EWA", "PAINTER": "The painter"}  # of the techniques that blend floats


@record
class TechniqueInput:
    """What the technique depends on before a view is prepared."""

    settings: Settings
    scene: Scene
    samples: int
    interactive: bool  # a view that is drawn repeatedly and at once
    lens: bool  # each sample sees through another point on the lens
    float_blend: bool  # the device can blend floats, as EWA and the painter do


@value_record
class Technique:
    """The technique that draws opaque points, with the reason."""

    name: str  # one of TECHNIQUES, but not AUTO
    because: str
    automatic: bool = True  # the settings leave the choice to us
    warning: str = ""  # why it is not the technique that the settings ask for; empty where it is


def decide_technique(given: TechniqueInput) -> Technique:
    """Returns the technique that the settings ask for; for AUTO the nearest to the truth that is worth its time.

    AUTO is the visibility buffer, but for what it cannot draw or would draw more slowly; there it is EWA where enough
    samples are drawn and some points have colours to average, else image space.
    """
    asked = given.settings.technique
    found = _automatic(given) if asked == "AUTO" else Technique(asked, "the settings say so", automatic=False)
    if found.name == "VISIBILITY" and (why := _why_not_visibility(given)):
        warning = "" if found.automatic else f"{why}: points are drawn in image space"
        return Technique("IMAGE_SPACE", why, found.automatic, warning)
    if found.name not in TITLES or given.float_blend:
        return found
    warning = ""
    if not found.automatic:
        warning = f"{TITLES[asked]} needs blending of floats, which this GPU lacks: points are drawn in image space"
    return Technique("IMAGE_SPACE", "this GPU cannot blend floats", found.automatic, warning)


def _why_not_visibility(given: TechniqueInput) -> str:
    """Returns why the visibility buffer cannot draw a scene; empty where it can."""
    if given.settings.budget != "NONE":
        return "a budget decides how many samples are drawn, one by one"
    return "each sample sees through another point on the lens" if given.lens else ""


def _why_others_are_faster(given: TechniqueInput) -> str:
    """Returns why another technique is worth its time more than the visibility buffer; empty where none is."""
    scene = given.scene
    opaque = np.array([not is_translucent(geometry, scene.materials) for geometry in scene.geometries], bool)
    count = np.bincount(scene.instances.geometry, minlength=len(scene.geometries)) * opaque
    if any(
        _is_surfels(geometry) for geometry, many in zip(scene.geometries, count >= MANY_INSTANCES, strict=True) if many
    ):
        return "many instances share nodes of surfaces"
    surfels = [len(g.cloud) * _is_surfels(g) if g.cloud is not None else 0 for g in scene.geometries]
    if given.interactive and float(count @ np.array(surfels, float)) > MOST_SURFELS_AT_ONCE:
        return "views that move draw nodes of so many points on surfaces"
    primitives = np.array([_primitives(geometry) for geometry in scene.geometries], float)
    if float(count @ primitives) > MOST_PRIMITIVES:
        return "instances have so many primitives that they are drawn by nodes"
    return ""


def _is_surfels(geometry: Geometry) -> bool:
    """Whether a geometry is points with normals, samples of its surface or given ones: nodes of these are not drawn by
    the visibility buffer."""
    if geometry.cloud is not None:
        return geometry.cloud.normal is not None
    return geometry.mesh is not None and geometry.primitive == "POINTS"


def _primitives(geometry: Geometry) -> int:
    """How many triangles, or points that are no balls, a geometry has. Balls are drawn by nodes where they are many."""
    if geometry.cloud is not None:
        balls = geometry.cloud.normal is None and geometry.cloud.radii is not None
        return 0 if balls else len(geometry.cloud)
    return 0 if geometry.mesh is None else len(geometry.mesh.triangles)


def shown_alike(scene: Scene, name: str) -> tuple[str, ...]:
    """Returns a warning where a technique does not tell the objects apart that show a mesh, although its materials read
    them; the visibility buffer does, but for samples of surfaces."""
    objects = scene.instances.objects
    if not objects:
        return ()
    shown = scene.instances.of_each(len(scene.geometries))
    alike = sorted({
        geometry.name
        for geometry, rows in zip(scene.geometries, shown, strict=True)
        if geometry.mesh is not None and geometry.mesh.objects and len(rows) > 1
        and (name != "VISIBILITY" or geometry.primitive == "POINTS")
        and any((objects[value][rows] != objects[value][rows[0]]).any() for value in geometry.mesh.objects)
    })  # fmt: skip
    if not alike:
        return ()
    more = f" and {len(alike) - 1} more" if len(alike) > 1 else ""
    why = "as points" if name == "VISIBILITY" else "without the visibility buffer"
    return (f'Instances are drawn {why}, and materials that read the object show some alike: "{alike[0]}"{more}',)


def confirm_technique(decided: Technique, prepared: Prepared) -> Technique:
    """Returns the technique for a view that was prepared for the one that `decide_technique` decided.

    AUTO draws disconnected points (foliage) in image space, and the pass `defocus` takes the painter's part where
    something is out of focus.
    """
    foliage = any(points.cloud.disconnected is not None for points in prepared.point_sets.values())
    if foliage and decided.name == "EWA" and decided.automatic:
        return replace(decided, name="IMAGE_SPACE", because="light passes between disconnected points")
    if prepared.out_of_focus is not None and decided.name == "PAINTER":
        return replace(decided, name="IMAGE_SPACE", because="the pass defocus paints")
    return decided


def _automatic(given: TechniqueInput) -> Technique:
    """The choice that AUTO makes."""
    why_not = _why_not_visibility(given) or _why_others_are_faster(given)
    if not why_not:
        return Technique("VISIBILITY", "every sub-sample is exact, and each surface is shaded once")
    name, because = _without_visibility(given)
    return Technique(name, f"{why_not}; {because}")


def _without_visibility(given: TechniqueInput) -> tuple[str, str]:
    """The choice that AUTO makes among the other techniques, and the reason."""
    scene = given.scene
    if given.interactive:
        return "IMAGE_SPACE", "views that move need the fastest"
    if not centres_decide(given.samples):
        return "IMAGE_SPACE", "it is the nearest with few samples"
    if np.bincount(scene.instances.geometry, minlength=1).max() >= MANY_INSTANCES:
        return "IMAGE_SPACE", "many instances share nodes"
    if any(_has_colors(geometry, scene.materials) for geometry in scene.geometries):
        return "EWA", "colours vary from point to point"
    return "IMAGE_SPACE", "no point has a colour of its own"


def _has_colors(geometry: Geometry, table: MaterialTable) -> bool:
    """Whether opaque points of a geometry have colours of their own."""
    if (cloud := geometry.cloud) is not None:
        opaque = cloud.opacity is None and cloud.extinction is None
        return opaque and (cloud.color is not None or cloud.emission is not None)
    if geometry.mesh is None or geometry.primitive == "POLYGONS":
        return False
    channels = {name for graph in graphs_of(geometry.mesh, table).values() for name in graph.channels}
    return bool(channels & {"base_color", "emission"})
