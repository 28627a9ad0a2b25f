"""The eyedropper of scans: a point of the window's picture, its map coordinate and attributes, read from the file."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np
from bpy.props import FloatProperty, FloatVectorProperty
from bpy_extras import view3d_utils

from ...core.numeric.record import record
from ...formats.points.reader import Columns
from ...stream.pick import Picked, Ray, pick
from ...stream.scan import scan_at
from ..convert.objects import linked_scan
from ..convert.selection.filters import Filters, filters_of, kept_points
from .linked_paths import linked_objects
from .operators import ORIGIN

REACH = 4.0  # pixels from the mouse within which points are looked for
PATIENCE = 10.0  # seconds that files have to answer


@record
class Pick:
    """A point that was picked."""

    name: str  # of its object
    world: np.ndarray  # (3,) float64
    point: Picked

    @property
    def lines(self) -> list[str]:
        """What a person is told of it."""
        x, y, z = self.point.coordinate
        found = [f"{self.name}: {x:,.3f}, {y:,.3f}, {z:,.3f}"]
        for name, value in self.point.attributes.items():
            numbers = value if isinstance(value, tuple) else (value,)
            found.append(f"{name}: {', '.join(f'{number:,.6g}' for number in numbers)}")
        return found


PICKS: list[Pick] = []  # the latest two


def distance() -> float | None:
    """Returns how far the latest two points lie apart in the scene, Blender units; None: there are not two."""
    return float(np.linalg.norm(PICKS[0].world - PICKS[1].world)) if len(PICKS) == 2 else None


def pick_along(start: np.ndarray, along: np.ndarray, reach: float, slope: float) -> Pick | None:
    """Returns the first point of all linked scans in view that a ray in the world meets. `reach`, `slope`: how far from
    it points may lie, and what that grows by in a unit of distance. Raises TimeoutError where files do not answer."""
    best: tuple[float, Pick] | None = None
    for ob in linked_objects():
        linked = linked_scan(ob)
        if linked is None or not ob.visible_get():
            continue
        world_from_object = np.array(ob.matrix_world, np.float64)
        if abs(np.linalg.det(world_from_object[:3, :3])) < 1e-30:
            continue
        object_from_world = np.linalg.inv(world_from_object)
        turned = object_from_world[:3, :3] @ along
        scale = float(np.linalg.norm(turned))
        first = object_from_world[:3, :3] @ start + object_from_world[:3, 3]
        ray = Ray(first, turned / scale, reach * scale, slope)
        scan, filters = scan_at(linked.path), filters_of(ob)

        def found(scan: Any = scan, ray: Ray = ray, filters: Filters | None = filters) -> Picked | None:
            scan.refresh()
            if scan.tree is None or scan.source is None:
                return None
            return pick(scan.tree, scan.source, ray, _kept(filters))

        point = _answer(found)
        if point is not None:
            world = world_from_object[:3, :3] @ point.position + world_from_object[:3, 3]
            away = float(np.linalg.norm(world - start))
            if best is None or away < best[0]:
                best = away, Pick(ob.name, world, point)
    return None if best is None else best[1]


def _kept(filters: Filters | None) -> Callable[[Columns], np.ndarray | None]:
    return lambda columns: kept_points(columns, filters)[0] if filters else None


def _answer(ask: Callable[[], Picked | None]) -> Picked | None:
    """What `ask` returns on another thread. Raises TimeoutError where it takes too long: a network may stall."""
    found: list[Picked | None] = []
    thread = threading.Thread(target=lambda: found.append(ask()), daemon=True, name="PointSplat picks")
    thread.start()
    thread.join(PATIENCE)
    if thread.is_alive():
        raise TimeoutError(f"The file of the scan has not answered for {PATIENCE:.0f} seconds")
    return found[0] if found else None


class POINTSPLAT_OT_pick_point(bpy.types.Operator):
    """Pick a point of a linked scan: its map coordinate and attributes, read from the file, and its distance to the
    point that was picked before"""

    bl_idname = "pointsplat.pick_point"
    bl_label = "Pick Point"
    bl_options = {"REGISTER"}

    start: FloatVectorProperty(name="Start", description="Where the ray begins, in the world", size=3, subtype="XYZ")
    along: FloatVectorProperty(name="Direction", description="Direction of the ray", size=3, default=(0.0, 0.0, -1.0))
    reach: FloatProperty(name="Reach", description="How far from the ray the point may lie", default=0.1, min=0.0)

    @classmethod
    def poll(cls, _context):
        return bool(linked_objects())

    def invoke(self, context, _event):
        if context.area is None or context.area.type != "VIEW_3D":
            self.report({"ERROR"}, "Points are picked in a 3D view")
            return {"CANCELLED"}
        context.window.cursor_modal_set("EYEDROPPER")
        context.workspace.status_text_set("Click a point of a scan; Esc ends")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type in {"ESC", "RIGHTMOUSE"}:
            return self._ended(context, {"CANCELLED"})
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"PASS_THROUGH"}
        region = next((r for r in context.area.regions if r.type == "WINDOW"), None)
        space = context.area.spaces.active
        if region is None:
            return self._ended(context, {"CANCELLED"})
        at = np.array([event.mouse_x - region.x, event.mouse_y - region.y], float)
        return self._ended(context, self._pick(*_ray(region, space.region_3d, at)))

    def execute(self, _context):
        along = np.array(self.along, float)
        length = float(np.linalg.norm(along))
        if length == 0:
            self.report({"ERROR"}, "The ray has no direction")
            return {"CANCELLED"}
        return self._pick(np.array(self.start, float), along / length, self.reach, 0.0)

    def _pick(self, start: np.ndarray, along: np.ndarray, reach: float, slope: float) -> set[str]:
        try:
            found = pick_along(start, along, reach, slope)
        except TimeoutError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if found is None:
            self.report({"INFO"}, "There is no point of a linked scan")
            return {"CANCELLED"}
        PICKS[:] = [*PICKS[-1:], found]
        self.report({"INFO"}, "; ".join(found.lines))
        if (apart := distance()) is not None:
            self.report({"INFO"}, f"{apart:,.4f} from the point before")
        return {"FINISHED"}

    def _ended(self, context: Any, result: set[str]) -> set[str]:
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)
        return result


def _ray(region: Any, view: Any, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Start and direction in the world of the ray through a place of a 3D view, in pixels; and how far from it REACH
    pixels are: at its start, and what is added in a unit of distance."""
    starts, directions = (
        [np.array(of(region, view, at + np.array([shift, 0.0])), np.float64) for shift in (0.0, REACH)]
        for of in (view3d_utils.region_2d_to_origin_3d, view3d_utils.region_2d_to_vector_3d)
    )
    return (
        starts[0],
        directions[0],
        float(np.linalg.norm(starts[1] - starts[0])),
        float(np.linalg.norm(directions[1] - directions[0])),
    )


class POINTSPLAT_OBJECT_PT_picked(bpy.types.Panel):
    bl_label = "Picked Points"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "object"
    bl_parent_id = "POINTSPLAT_OBJECT_PT_scan"

    @classmethod
    def poll(cls, context):
        return context.object is not None and ORIGIN in context.object and bool(PICKS)

    def draw(self, _context):
        for one in PICKS:
            column = self.layout.box().column(align=True)
            for line in one.lines:
                column.label(text=line)
        if (apart := distance()) is not None:
            self.layout.label(text=f"Distance: {apart:,.4f}")


def _menu(self: Any, _context: bpy.types.Context) -> None:
    self.layout.operator(POINTSPLAT_OT_pick_point.bl_idname, icon="EYEDROPPER")


CLASSES = (POINTSPLAT_OT_pick_point, POINTSPLAT_OBJECT_PT_picked)


def register() -> None:
    bpy.types.VIEW3D_MT_view.append(_menu)


def unregister() -> None:
    bpy.types.VIEW3D_MT_view.remove(_menu)
    PICKS.clear()
