"""Motion blur of final renders: each sample of a picture shows the scene at a moment of its own (Cook et al. 1984).

What moves may be anything: objects, cameras, lights, deformed meshes, materials. Where nothing does, a picture is drawn
as without it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

import bpy
import numpy as np

from ..core.scene.camera import Camera
from ..core.scene.scene import Geometry, Scene
from ..render.passes.outputs import BY_KEY, CRYPTO
from ..render.plan.request import Request, Result

STEPS = 256  # of the shutter's curve
Shown = tuple[Scene, Camera]


def moments(render: bpy.types.RenderSettings, count: int) -> np.ndarray:
    """Moments of the samples, (count,) float64 in frames from the present one, as dense as the shutter is open; empty
    without motion blur.

    They are the quantiles of the shutter's curve, as in Cycles, and hence independent of its height.
    """
    if not render.use_motion_blur or render.motion_blur_shutter <= 0 or count < 2:
        return np.zeros(0)
    mapping = render.motion_blur_shutter_curve
    mapping.initialize()
    at = (np.arange(STEPS) + 0.5) / STEPS
    open_ = np.array([max(mapping.evaluate(mapping.curves[0], float(x)), 0.0) for x in at])
    whole = np.concatenate([[0.0], np.cumsum(open_)])
    if whole[-1] <= 0:
        return np.zeros(0)
    share = np.interp((np.arange(count) + 0.5) / count, whole / whole[-1], np.linspace(0, 1, STEPS + 1))
    begin = {"START": 0.0, "CENTER": -0.5, "END": -1.0}[render.motion_blur_position]
    return (share + begin) * render.motion_blur_shutter


def draw(
    times: np.ndarray,
    show: Callable[[float], Shown],
    draw_one: Callable[[Scene, Request], tuple[Result, list[str]]],
    scene: Scene,
    request: Request,
) -> tuple[Result, list[str]]:
    """Draw the picture of `request` with a sample at each of `times`; return it and problems with the device.

    show: the scene and the camera so many frames after the present one, which `scene` and `request` are of. Passes that
    are no averages are of the present one.
    """
    count = len(times)
    middle = count // 2
    known = {k: show(times[k]) for k in dict.fromkeys((0, count - 1, middle))}
    if all(same(known[0], other) for other in known.values()):
        return draw_one(scene, request)
    beside = frozenset(key for key in request.passes if key in CRYPTO or not BY_KEY[key].averaged)
    settings = replace(request.settings, use_adaptive_sampling=False, budget="NONE")
    each = replace(request, settings=settings, samples=count, passes=request.passes - beside)
    sums: dict[str, np.ndarray] = {}
    reports, problems = [], []
    result = Result({}, {})
    # The middle one was shown last: it is drawn first, before another takes its place on the device, and gathers the
    # indirect light of all.
    for k in (middle, *(k for k in reversed(range(count)) if k != middle)):
        shown, camera = known.pop(k, None) or show(times[k])
        result, told = draw_one(shown, replace(each, camera=camera, moment=(k, count), known_light=k != middle))
        if result.cancelled:
            return result, problems
        problems += told
        reports.append(result.report)
        for key, pixels in result.pixels.items():
            sums[key] = pixels.astype(np.float64) if key not in sums else sums[key] + pixels
    mean = {key: (total / count).astype(np.float32) for key, total in sums.items()}
    if beside:
        still, told = draw_one(scene, replace(request, passes=beside))
        if still.cancelled:
            return still, problems
        problems += told
        reports.append(still.report)
        mean |= {key: pixels for key, pixels in still.pixels.items() if key not in mean}
    return replace(result, pixels=mean, report=_joined(reports)), problems


def same(a: Any, b: Any) -> bool:
    """Whether two parts of scenes would be drawn alike: records, tuples, dicts, arrays or values; geometries by key."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, Geometry):
        return a.key == b.key
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and bool(np.array_equal(a, b))
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return bool(a == b)


def _joined(reports: list[dict[str, Any]]) -> dict[str, Any]:
    """The report of the whole picture: what the first one says, the time of all, and what any of them warns of."""
    spent: dict[str, float] = {}
    for entry in (entry for one in reports for entry in one["passes"]):
        spent[entry["name"]] = spent.get(entry["name"], 0.0) + entry["ms"]
    return {
        **reports[0],
        "passes": [{"name": name, "ms": round(ms, 3)} for name, ms in spent.items()],
        "samples": sum(one["samples"] for one in reports),
        "warnings": list(dict.fromkeys(warning for one in reports for warning in one["warnings"])),
    }
