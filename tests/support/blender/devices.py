"""Pictures of one case by both devices inside Blender, and how far they differ."""

from __future__ import annotations

import bpy
import gpu
import numpy as np

from pointsplat_addon.render.passes.outputs import BACKGROUND_DEPTH
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes.case import Case


def start_gpu() -> None:
    """Blender 4.5 in the background makes its GPU context only for an engine that asks for it, while it renders."""
    if hasattr(gpu, "init"):
        gpu.init()
        return

    class Starter(bpy.types.RenderEngine):
        bl_idname = "POINTSPLAT_TEST_STARTER"
        bl_label = "Starter"
        bl_use_gpu_context = True

        def render(self, depsgraph):
            pass

    # A scene of its own: other tests may have left one without a camera.
    scene = bpy.data.scenes.new("starter")
    scene.camera = bpy.data.objects.new("starter", bpy.data.cameras.new("starter"))
    scene.collection.objects.link(scene.camera)
    bpy.utils.register_class(Starter)
    try:
        scene.render.engine, scene.render.resolution_x, scene.render.resolution_y = Starter.bl_idname, 8, 8
        bpy.ops.render.render(scene=scene.name)
    finally:
        bpy.data.cameras.remove(scene.camera.data)
        bpy.data.scenes.remove(scene)
        bpy.utils.unregister_class(Starter)


Pictures = dict[str, np.ndarray]
COLORS = ("combined", "normal", "mist")
IDENTITIES = ("object_index", "material_index")
EDGES = 0.01  # of the pixels: those that an edge crosses within rounding


def pictures(renderer: Renderer, case: Case) -> Pictures:
    return renderer.render(case.scene, case.request(samples=2)).pixels


def differences(here: Pictures, there: Pictures) -> dict[str, float]:
    """Largest differences where both show the same object, and the share of pixels where they do not."""
    assert here.keys() == there.keys()
    same = np.ones(here["depth"].shape[:2], bool)
    for key in IDENTITIES:
        same &= here[key][..., 0] == there[key][..., 0]
    same &= (here["depth"][..., 0] < BACKGROUND_DEPTH) == (there["depth"][..., 0] < BACKGROUND_DEPTH)
    found = {"edges": float(np.mean(~same))}
    for key in COLORS:
        found[key] = float(np.abs(here[key] - there[key])[same].max(initial=0))
    for key in ("depth", "position"):
        size = np.maximum(np.linalg.norm(here["position"], axis=2, keepdims=True), np.abs(here["depth"]))
        found[key] = float((np.abs(here[key] - there[key]) / np.maximum(size, 1e-30))[same].max(initial=0))
    return found


def agree(here: Pictures, there: Pictures) -> None:
    found = differences(here, there)
    # Measured 0 throughout, where both run on one driver.
    assert found["edges"] <= EDGES
    for key in COLORS:
        assert found[key] <= 1 / 255, key
    assert found["depth"] <= 1e-5
    assert found["position"] <= 1e-5
