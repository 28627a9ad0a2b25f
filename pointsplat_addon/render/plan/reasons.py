"""Lists all passes that a picture may have, and says why each of the others has not run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from dataclasses import field

from ...core.numeric.record import value_record
from ...core.scene.settings import Settings
from ..passes.shading.averages import averaged
from ..passes.shading.data import data
from .plan import Plan

# In the order in which they run; the names of the report.
PASSES: dict[str, str] = {
    "shadows": "tables of what light meets, on the processor",
    "shadow maps": "depths of what lights see, once for all views",
    "order": "translucent and captured splats sorted back to front, on the processor",
    "cover": "splats into the visibility buffer",
    "project": "splats to pixels, the nearest of each pixel",
    "resolve": "ellipse and attributes of each pixel's splat",
    "splats": "EWA: all splats projected, once for a view",
    "visibility": "EWA: the nearest surface of each pixel",
    "blend": "EWA: attributes times kernels",
    "normalise": "EWA: sums over weights",
    "occlusion": "triangles that may hide others, and what they hide",
    "polygons": "triangles",
    "spheres": "wide balls, by the pixels' rays",
    "lines": "strands",
    "group": "sub-samples grouped by surface",
    "attributes": "attributes of what stands for each group",
    "pull": "image space: means up the pyramid",
    "push": "image space: holes filled down the pyramid",
    "data": "depth, position, motion and indices under the pixels' centres",
    "averages": "normal, colour and mist of what is painted",
    "light tree": "surfels of all surfaces, and the light that leaves them",
    "gather": "what surfaces receive from the world and from each other",
    "shade": "light on what is opaque",
    "backdrop": "a picture of the world that is out of focus, once for a view",
    "background": "the world where nothing else is",
    "mattes": "what shows through meshes that stand for captured surfaces, and shadows on these",
    "spread": "groups brought to pixels by the pixel filter",
    "reach": "how much of each light reaches translucent splats, for all views",
    "captured": "captured splats projected, once for a view",
    "light": "translucent splats lit, once for a view",
    "tiles": "splats out of focus listed by the tiles that they blur into, on the processor",
    "defocus": "what is out of focus, gathered by each pixel over what is in focus",
    "opaque depth": "what hides translucent splats",
    "expand": "a layer of the groups of each pixel",
    "translucent": "splats blended back to front",
    "enlarge": "a coarse translucent picture to the size of the fine one",
    "difference": "what translucent splats change in a layer, by the pixel filter",
    "compose": "layers of translucent triangles, front to back",
    "captured depth": "where captured splats have hidden half of the light behind them",
    "add": "a sample with what is translucent to the sums",
    "eye dome": "pixels darkened by what lies in front of their neighbours",
    "adapt": "tiles whose samples agree are found",
    "light passes": "terms of the light, each drawn as the picture is",
}
IMAGE_SPACE, BY_EWA = ("project", "resolve", "pull", "push"), ("splats", "visibility", "blend", "normalise")
BY_BUFFER = ("cover", "group", "attributes", "spread")
TRANSLUCENT = (
    "order",
    "reach",
    "light",
    "captured",
    "opaque depth",
    "expand",
    "translucent",
    "enlarge",
    "difference",
    "add",
)
# Why a pass that the plan has did not run.
LATE = {
    "shadow maps": "those of an earlier picture still hold",
    "order": "the order of an earlier picture still holds",
    "captured": "an earlier picture of the same view has them",
    "reach": "what reaches them is known from an earlier picture",
    "difference": "panes are near all that is seen",
    "occlusion": "there are few triangles, or few that others may hide",
    "light passes": "no pass of light is asked for",
}
UNKNOWN = "no sample came so far"
LINEAR = "linear blending is set"


@value_record
class Absences:
    """Why a view lacks what it might have; each is empty where the view has it."""

    tables: str = "nothing casts shadows"  # of shadows
    maps: str = "nothing casts shadows"  # of their depths
    out_of_view: Mapping[str, str] = field(default_factory=dict)  # by kind of things (render/prepare/in_view.py)
    out_of_focus: str = ""  # beyond that the camera has no depth of field
    blurred_world: str = "the camera has no depth of field"
    indirect: str = "indirect light is switched off"  # beyond that nothing sends any
    eye_dome: str = "eye-dome lighting is switched off"
    trained: str = LINEAR  # blending of captured splats as they were trained


def reasons(plan: Plan, passes: frozenset[str], absences: Absences) -> dict[str, str]:
    """Returns why each pass that a plan leaves out is not needed, by its name. `passes`: those that are asked for."""
    by_buffer = plan.sub_samples > 0
    unseen = absences.out_of_view
    unshadowed = bool(absences.tables and absences.maps)
    found = {name: why for name, why in (("shadows", absences.tables), ("shadow maps", absences.maps)) if why}
    found |= _of_points(plan, unseen.get("points", "nothing is drawn as points"))
    if not by_buffer:
        why = "another technique draws" if plan.solid else "nothing opaque is drawn"
        found |= dict.fromkeys((*BY_BUFFER, "occlusion"), why)
    elif not plan.points:
        found["cover"] = unseen.get("points", "nothing is drawn as points")
    if not plan.polygons:
        found |= dict.fromkeys(("occlusion", "polygons"), unseen.get("polygons", "nothing is drawn as polygons"))
    if not plan.spheres:
        found["spheres"] = unseen.get("spheres", "no ball without a normal is wide")
    if not plan.lines:
        found["lines"] = "nothing is drawn as lines"
    if not plan.data:
        found["data"] = "nothing opaque is drawn" if data(passes) else "no pass asks for position, index or motion"
    if not (plan.painter and plan.points and averaged(passes)):
        found["averages"] = "no auxiliary pass averages what is painted"
    if not plan.shaded.solid:
        found["shade"] = "points are painted" if plan.painter else "nothing opaque is drawn"
    if plan.translucent is None or not plan.translucent.depth:
        found["captured depth"] = "nothing is a captured splat whose depth is asked for"
    if not plan.panes:
        found["compose"] = "no translucent mesh is drawn as triangles"
    if not plan.matte_light.lit:
        found["mattes"] = "no mesh stands for captured surfaces"
    if not plan.backdrop:
        found["backdrop"] = absences.blurred_world
    if not plan.background:
        found["background"] = "the pass defocus draws the world" if plan.defocus else "the film is transparent"
    unscattered = absences.indirect or "nothing that is drawn would scatter it"
    if not plan.indirect:
        found["gather"] = unscattered
    if not (plan.indirect or plan.gathers_media):
        found["light tree"] = unscattered
    if not plan.eye_dome:
        found["eye dome"] = absences.eye_dome
    if not plan.defocus:
        found |= dict.fromkeys(("tiles", "defocus"), absences.out_of_focus or "the camera has no depth of field")
    return found | _of_translucent(plan, not unshadowed, unseen.get("translucent", "nothing is translucent"))


def why_no_indirect(settings: Settings, technique: str) -> str:
    """Returns why a picture has no indirect light; empty where it has, if there is any."""
    if not settings.use_indirect:
        return "indirect light is switched off"
    return "" if technique == "VISIBILITY" else f"only the Visibility Buffer has it, and {technique} draws"


def why_no_eye_dome(settings: Settings, technique: str, opaque: bool, out_of_focus: bool) -> str:
    """Returns why a picture has no eye-dome lighting; empty where it has. `opaque`: something is."""
    if not settings.use_eye_dome:
        return "eye-dome lighting is switched off"
    if out_of_focus:
        return "something is out of focus"
    if technique != "VISIBILITY":
        return f"the technique {technique} has no depths of one kind for it"
    return "" if opaque else "nothing opaque is drawn"


def why_not_trained(settings: Settings, opaque: bool, others: bool, lit: bool, out_of_focus: bool) -> str:
    """Returns why captured splats are not blended as they were trained; empty where they are. `opaque`, `others`: what
    else is in view, the others being translucent. `lit`: light changes some. `out_of_focus`: things may be."""
    if settings.captured_blending != "TRAINED":
        return LINEAR
    if opaque:
        return "something opaque is in view"
    if others:
        return "something else that is translucent is in view"
    if lit:
        return "some are shadow receivers or relit"
    return "the camera has depth of field" if out_of_focus else ""


def _of_points(plan: Plan, none: str) -> dict[str, str]:
    """Why passes of points are left out. `none`: why nothing is drawn as points."""
    if not plan.points:
        why = "points are painted" if plan.painter else none
        return dict.fromkeys((*IMAGE_SPACE, *BY_EWA), why)
    if plan.painter:
        return dict.fromkeys(BY_EWA, "points are painted")
    if plan.sub_samples:
        return dict.fromkeys((*IMAGE_SPACE, *BY_EWA), "points are drawn by the visibility buffer")
    if plan.ewa is None:
        return dict.fromkeys(BY_EWA, "points are drawn in image space")
    return dict.fromkeys(IMAGE_SPACE, "points are drawn by EWA")


def _of_translucent(plan: Plan, shadowed: bool, none: str) -> dict[str, str]:
    """Why translucent passes are left out. `shadowed`: a light casts shadows. `none`: why nothing is."""
    if plan.translucent is None:
        drawn = [name for name in TRANSLUCENT if not (plan.panes and name == "add")]
        return dict.fromkeys(drawn, "translucent meshes are drawn as triangles" if plan.panes else none)
    if plan.defocus:
        drawn = (name for name in TRANSLUCENT if name != "light")
        return dict.fromkeys(drawn, "the pass defocus draws what is translucent")
    found = {}
    if not plan.translucent.captured:
        found["captured"] = "nothing is a captured splat"
    if plan.translucent.alone:
        found |= dict.fromkeys(("light", "reach"), "captured splats emit light")
    elif not shadowed:
        found["reach"] = "no light casts shadows on it"
    if plan.translucent.grouped:
        found["opaque depth"] = "the visibility buffer holds it"
    else:
        found |= dict.fromkeys(("expand", "difference"), "translucent splats are blended over each sample")
    if plan.panes and not plan.translucent.captured:
        found["difference"] = "layers of panes tell what changes"
    if not plan.translucent.opaque:
        found["opaque depth"] = "nothing opaque hides what is translucent"
    if not plan.coarse:
        found["enlarge"] = "only views that move are coarse at first, where no splat is coloured, painted or a holdout"
    return found


def not_run(
    left_out: Iterable[tuple[str, str]], ran: Set[str], one_color: bool, not_adaptive: str, keeps_light: bool
) -> list[tuple[str, str]]:
    """Returns the passes that did not run, each with its reason.

    `left_out`: (pass, reason) of the plan. `ran`: the passes that ran. `one_color`: one colour fills the picture.
    `not_adaptive`: why all pixels get all samples; empty where some may not. `keeps_light`: the light that reaches
    translucent splats can be kept from picture to picture.
    """
    found = [entry for entry in left_out if entry[0] not in ran]
    known = {name for name, _ in found} | ran
    late = dict(LATE)
    if one_color:
        late |= dict.fromkeys(("background", "adapt"), "one colour fills the picture")
    elif not keeps_light:
        late["reach"] = "several of its instances share splats, or lights are too many"
    if not_adaptive:
        late["adapt"] = not_adaptive
    return found + [(name, late.get(name, UNKNOWN)) for name in PASSES if name not in known]
