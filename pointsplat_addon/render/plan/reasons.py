"""All passes that a picture may have, and why one of them has not run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .plan import Plan

# In the order in which they run; the names of the report.
PASSES: dict[str, str] = {
    "shadows": "tables of what light meets, on the processor",
    "order": "translucent splats sorted back to front, on the processor",
    "project": "splats to pixels, the nearest of each pixel",
    "resolve": "ellipse and attributes of each pixel's splat",
    "splats": "EWA: all splats projected, once for a view",
    "visibility": "EWA: the nearest surface of each pixel",
    "blend": "EWA: attributes times kernels",
    "normalise": "EWA: sums over weights",
    "polygons": "triangles",
    "spheres": "wide balls, by the pixels' rays",
    "lines": "strands",
    "pull": "image space: means up the pyramid",
    "push": "image space: holes filled down the pyramid",
    "data": "depth, position, motion and indices under the pixels' centres",
    "averages": "normal, colour and mist of what is painted",
    "shade": "light on what is opaque",
    "backdrop": "a picture of the world that is out of focus, once for a view",
    "background": "the world where nothing else is",
    "reach": "how much of each lamp's light reaches translucent splats, for all views",
    "light": "translucent splats lit, once for a view",
    "tiles": "splats out of focus listed by the tiles that they blur into, on the processor",
    "defocus": "what is out of focus, gathered by each pixel over what is in focus",
    "opaque depth": "what hides translucent splats",
    "translucent": "splats blended back to front",
    "enlarge": "a coarse translucent picture to the size of the fine one",
    "add": "a sample with what is translucent to the sums",
    "adapt": "tiles whose samples agree are found",
}
IMAGE_SPACE, BY_EWA = ("project", "resolve", "pull", "push"), ("splats", "visibility", "blend", "normalise")
TRANSLUCENT = ("order", "reach", "light", "opaque depth", "translucent", "enlarge", "add")
# Why a pass that the plan has did not run.
LATE = {
    "order": "the order of an earlier picture still holds",
    "reach": "what reaches them is known from an earlier picture",
}
UNKNOWN = "no sample came so far"


def reasons(
    plan: Plan,
    asked: Mapping[str, bool],
    unshadowed: str,
    unseen: Mapping[str, str],
    in_focus: str,
    sharp_world: str,
) -> dict[str, str]:
    """Why each pass that a plan leaves out is not needed, by its name.

    `asked`: whether a pass of "data" is asked for, and one that is "averaged" beside Combined. `unshadowed`: why no
    lamp has a table of shadows; empty where one has. `unseen`: why kinds of things are left out (render/prepare/in_view.py).
    `in_focus`: why nothing is out of focus, beyond that the camera has no lens.
    `sharp_world`: why the world is not blurred.
    """
    found = {"shadows": unshadowed} if unshadowed else {}
    found |= _of_points(plan, unseen.get("points", "nothing is drawn as points"))
    if not plan.polygons:
        found["polygons"] = unseen.get("polygons", "nothing is drawn as polygons")
    if not plan.spheres:
        found["spheres"] = unseen.get("spheres", "no ball without a normal is wide")
    if not plan.lines:
        found["lines"] = "nothing is drawn as lines"
    if not plan.data:
        found["data"] = "nothing opaque is drawn" if asked["data"] else "no pass asks for position, index or motion"
    if not (plan.painter and plan.points and asked["averaged"]):
        found["averages"] = "no pass beside the picture averages what is painted"
    if not plan.shaded.solid:
        found["shade"] = "points are painted" if plan.painter else "nothing opaque is drawn"
    if not plan.backdrop:
        found["backdrop"] = sharp_world
    if not plan.background:
        found["background"] = "the pass defocus draws the world" if plan.defocus else "the film is transparent"
    if not plan.defocus:
        found |= dict.fromkeys(("tiles", "defocus"), in_focus or "the camera has no depth of field")
    return found | _of_translucent(plan, not unshadowed, unseen.get("translucent", "nothing is translucent"))


def _of_points(plan: Plan, none: str) -> dict[str, str]:
    if not plan.points:
        why = "points are painted" if plan.painter else none
        return dict.fromkeys((*IMAGE_SPACE, *BY_EWA), why)
    if plan.painter:
        return dict.fromkeys(BY_EWA, "points are painted")
    if plan.ewa is None:
        return dict.fromkeys(BY_EWA, "points are drawn in image space")
    return dict.fromkeys(IMAGE_SPACE, "points are drawn by EWA")


def _of_translucent(plan: Plan, shadowed: bool, none: str) -> dict[str, str]:
    if plan.translucent is None:
        return dict.fromkeys(TRANSLUCENT, none)
    if plan.defocus:
        drawn = (name for name in TRANSLUCENT if name != "light")
        return dict.fromkeys(drawn, "the pass defocus draws what is translucent")
    found = {}
    if not shadowed:
        found["reach"] = "no lamp casts shadows on it"
    if not plan.translucent.opaque:
        found["opaque depth"] = "nothing opaque hides what is translucent"
    if not plan.coarse:
        found["enlarge"] = "only views that move are coarse at first, where no splat is coloured, painted or a holdout"
    return found


def not_run(
    left_out: Iterable[tuple[str, str]], ran: Set[str], trivial: bool, everywhere: str, reaches: bool
) -> list[tuple[str, str]]:
    """Passes that did not run, and why. `left_out`: of the plan, and why. `ran`: those that did. `trivial`: one colour
    fills the picture. `everywhere`: why no part of it ends early; empty where one may. `reaches`: what reaches
    translucent splats could be kept."""
    found = [entry for entry in left_out if entry[0] not in ran]
    known = {name for name, _ in found} | ran
    late = dict(LATE)
    if trivial:
        late = {"background": "one colour fills the picture", "adapt": "one colour fills the picture"}
    elif not reaches:
        late["reach"] = "several of its instances share splats, or lamps are too many"
    if everywhere:
        late["adapt"] = everywhere
    return found + [(name, late.get(name, UNKNOWN)) for name in PASSES if name not in known]
