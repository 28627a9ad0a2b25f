"""Registration, the settings that Blender shows, and the panels."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import bpy
import pytest

import pointsplat_addon
from pointsplat_addon.core.scene.settings import PRIMITIVES, Settings

ROOT = Path(__file__).resolve().parents[2]
IN_NEW_SCENES = replace(Settings(), **Settings.IN_BLENDER)


@pytest.fixture
def registered():
    pointsplat_addon.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    yield
    pointsplat_addon.unregister()


def names(cls):
    return {c.bl_idname for c in cls.__subclasses__() if hasattr(c, "bl_idname") and c.is_registered}


@pytest.mark.usefixtures("registered")
def test_every_setting_is_a_property_with_its_default_and_range():
    properties = bpy.context.scene.pointsplat.bl_rna.properties
    for field in (f for f in fields(Settings) if f.name not in Settings.OF_BLENDER):
        found = properties[field.name]
        assert found.description
        if field.name in Settings.RANGES:
            low, high = Settings.RANGES[field.name]
            assert found.hard_min == pytest.approx(low, rel=1e-7)  # float32
            assert found.hard_max == high
        assert found.default == Settings.IN_BLENDER.get(field.name, field.default)
    assert bpy.context.scene.pointsplat.settings() == IN_NEW_SCENES


@pytest.mark.usefixtures("registered")
def test_the_pixel_filter_is_blenders():
    render = bpy.context.scene.render
    for given, taken in ((0.0, 0.01), (0.75, 0.75), (500.0, 10.0)):
        render.filter_size = given
        assert bpy.context.scene.pointsplat.settings() == replace(IN_NEW_SCENES, filter_size=taken)


@pytest.mark.usefixtures("registered")
def test_objects_choose_their_primitive_spacing_and_extinction():
    ob = bpy.data.objects.new("Object", None)
    assert [item.identifier for item in ob.pointsplat.bl_rna.properties["primitive"].enum_items] == list(PRIMITIVES)
    assert (ob.pointsplat.primitive, ob.pointsplat.spacing, ob.pointsplat.extinction) == ("AUTO", 0, 0)
    assert ob.pointsplat.bl_rna.properties["spacing"].unit == "LENGTH"
    ob.pointsplat.spacing = ob.pointsplat.extinction = -1
    assert ob.pointsplat.spacing == ob.pointsplat.extinction == 0


@pytest.mark.usefixtures("registered")
def test_a_script_that_sets_an_objects_property_is_seen_by_the_evaluated_copy():
    mesh = bpy.data.meshes.new("Mesh")
    ob = bpy.data.objects.new("Object", mesh)
    bpy.context.collection.objects.link(ob)
    bpy.context.view_layer.update()
    ob.pointsplat.primitive = "POLYGONS"
    bpy.context.view_layer.update()
    assert ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).pointsplat.primitive == "POLYGONS"


@pytest.mark.usefixtures("registered")
def test_settings_survive_saving_and_loading(tmp_path):
    bpy.context.scene.pointsplat.tolerance = 2.5
    bpy.context.scene.pointsplat.device = "OPENGL"
    bpy.context.scene.pointsplat.use_shadows = False
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert bpy.context.scene.pointsplat.tolerance == 1
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))
    assert bpy.context.scene.pointsplat.settings() == replace(
        IN_NEW_SCENES, tolerance=2.5, device="OPENGL", use_shadows=False
    )


def test_registering_twice_and_in_cycles_leaves_nothing_behind():
    handlers = [len(getattr(bpy.app.handlers, n)) for n in ("load_pre", "load_post", "undo_post", "redo_post")]
    for _ in range(3):
        pointsplat_addon.register()
        pointsplat_addon.register()
        assert "POINTSPLAT" in names(bpy.types.RenderEngine)
        assert hasattr(bpy.types.Scene, "pointsplat")
        pointsplat_addon.unregister()
        pointsplat_addon.unregister()
        assert "POINTSPLAT" not in names(bpy.types.RenderEngine)
        assert not hasattr(bpy.types.Scene, "pointsplat")
        assert not hasattr(bpy.types.Object, "pointsplat")
        panels = bpy.types.Panel.__subclasses__()
        assert [p for p in panels if "POINTSPLAT" in getattr(p, "COMPAT_ENGINES", ())] == []
    after = [len(getattr(bpy.app.handlers, n)) for n in ("load_pre", "load_post", "undo_post", "redo_post")]
    assert after == handlers


@pytest.mark.usefixtures("registered")
def test_blenders_own_panels_are_shown_where_they_make_sense():
    shown = {p.__name__ for p in bpy.types.Panel.__subclasses__() if "POINTSPLAT" in getattr(p, "COMPAT_ENGINES", ())}
    assert {
        "RENDER_PT_color_management",
        "EEVEE_MATERIAL_PT_surface",
        "EEVEE_MATERIAL_PT_context_material",
        "EEVEE_WORLD_PT_surface",
        "DATA_PT_EEVEE_light",
        "VIEWLAYER_PT_layer_passes",
    } <= shown
    assert not [name for name in shown if "freestyle" in name or "gpencil" in name]


def test_a_process_that_leaves_the_engine_registered_ends():
    """Blender 4.5 as a Python package hangs at exit otherwise."""
    code = "import bpy, pointsplat_addon; pointsplat_addon.register(); print('end', flush=True)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "end" in done.stdout.splitlines()
    assert "Traceback" not in done.stderr
