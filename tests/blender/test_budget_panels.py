"""Budgets in Blender: properties, the panels that show them, the report and the picture's metadata."""

from __future__ import annotations

from typing import Any

import bpy
import pytest

import pointsplat_addon
from pointsplat_addon.host import engine
from pointsplat_addon.host.ui import last_render, panels


@pytest.fixture(autouse=True)
def empty_file():
    pointsplat_addon.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.pointsplat.use_indirect = False  # direct light alone
    last_render.REPORT.clear()
    yield
    pointsplat_addon.unregister()


def scene_with_a_cube(**settings) -> Any:
    scene = bpy.context.scene
    scene.render.engine = "POINTSPLAT"
    scene.render.resolution_x, scene.render.resolution_y = 40, 30
    scene.render.resolution_percentage = 100
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.camera.location = (0, 0, 10)
    bpy.context.collection.objects.link(scene.camera)
    bpy.ops.mesh.primitive_cube_add(rotation=(0.3, 0.2, 0.1))
    bpy.ops.object.light_add(type="SUN", location=(0, 0, 5))
    scene.pointsplat.device = "OPENGL"
    for name, value in settings.items():
        setattr(scene.pointsplat, name, value)
    return scene


def rendered(scene: Any, folder: Any) -> dict[str, str]:
    """PointSplat's metadata of the picture that is saved."""
    scene.render.filepath = str(folder / "out.exr")
    scene.render.image_settings.file_format = "OPEN_EXR"
    bpy.ops.render.render(write_still=True)
    data = (folder / "out.exr").read_bytes()
    return {name: "" for name in ("pointsplat/seconds", "pointsplat/error") if name.encode() in data}


class Row:
    """A layout that keeps what is drawn into it."""

    def __init__(self, drawn: list[tuple]) -> None:
        self.drawn = drawn

    def __getattr__(self, name: str) -> Any:
        if name in ("row", "column", "split"):
            return lambda **_: Row(self.drawn)
        return lambda *values, **named: self.drawn.append((name, values[1:], named))


def drawn(panel: type, scene: Any) -> list[tuple]:
    """Calls that the panel's draw makes of its layout, as (name, arguments, named ones)."""

    class Context:
        engine = "POINTSPLAT"

    Context.scene = scene
    found: list[tuple] = []

    class Shown:
        layout = Row(found)
        split_layout = panels._Panel.split_layout

    panel.draw(Shown(), Context)
    return found


def test_the_panel_shows_the_budget_that_is_chosen():
    scene = scene_with_a_cube()
    shown = {"NONE": ["budget"], "TIME": ["budget", "time_budget"], "ERROR": ["budget", "error_budget"]}
    for budget, names in shown.items():
        scene.pointsplat.budget = budget
        found = drawn(panels.POINTSPLAT_RENDER_PT_budget, scene)
        assert [values[0] for name, values, _ in found if name == "prop"] == names


def test_budgets_stay_within_their_ranges():
    settings = bpy.context.scene.pointsplat
    assert settings.budget == "NONE"
    settings.time_budget, settings.error_budget = 0.0, 5.0
    assert (settings.time_budget, settings.error_budget) == (1.0, 1.0)


@pytest.mark.parametrize("budget", ["TIME", "ERROR"])
def test_a_final_render_tells_its_estimate(budget, tmp_path):
    scene = scene_with_a_cube(budget=budget, time_budget=300.0, error_budget=0.01)
    fields = rendered(scene, tmp_path)
    estimate = engine.last_report["estimate"]
    assert estimate["seconds"] > 0
    assert set(fields) == {"pointsplat/seconds", "pointsplat/error"}
    if budget == "ERROR":
        assert 0 < estimate["rmse"] <= 0.01  # measured 0.0056


def test_without_a_budget_there_is_no_estimate(tmp_path):
    scene = scene_with_a_cube(samples=2)
    assert set(rendered(scene, tmp_path)) == {"pointsplat/seconds"}
    assert "estimate" not in engine.last_report


def test_the_last_render_is_shown_with_a_bar_for_each_pass(tmp_path):
    scene = scene_with_a_cube(samples=2)
    assert not last_render.REPORT
    assert drawn(panels.POINTSPLAT_RENDER_PT_last_render, scene) == []
    rendered(scene, tmp_path)
    found = drawn(panels.POINTSPLAT_RENDER_PT_last_render, scene)
    labels = [named["text"] for name, _, named in found if name == "label"]
    assert labels[::2][:4] == ["Time", "Points", "Samples", "Technique"]
    assert labels[5] == "5 of each pixel"
    bars = [named["factor"] for name, _, named in found if name == "progress"]
    assert bars == sorted(bars, reverse=True)
    assert bars[0] == 1.0
    assert {"Polygons", "Shade"} <= set(labels)


def test_blenders_layout_has_bars():
    assert "progress" in bpy.types.UILayout.bl_rna.functions


def test_a_render_that_failed_leaves_nothing_to_show():
    scene = scene_with_a_cube()
    scene.camera = None
    with pytest.raises(RuntimeError):
        bpy.ops.render.render()
    assert drawn(panels.POINTSPLAT_RENDER_PT_last_render, scene) == []


def test_many_passes_are_the_longest_ones():
    report = {"passes": [{"name": str(i), "ms": float(i)} for i in range(20)]}
    found = last_render.bars(report)
    assert len(found) == last_render.MOST_BARS
    assert found[0] == ("19", 19.0, 1.0)
    assert last_render.bars({"passes": [{"name": "a", "ms": 0.0}]}) == []
