"""A frame of a film is the same to the bit alone and after those before it: machines of a farm draw any of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.volume import Volume
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.prepare import captured, hierarchies
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, clouds, drawing, meshes
from scripts.scenes.captured_cases import captured_sphere

FRAMES = 5
# From near to far, so that what a near view needs is there for the far one, and one that is hardly turned.
AWAY = 3.0, 40.0, 60.0, None, None  # None: as far as the case says
TURN = 3e-4  # units at the target, of the last: less than a slice of the smoke's draw order
PASSES = frozenset({"combined", "depth", "normal"})


@cache
def geometries(shape: int) -> tuple[Geometry, ...]:
    """Meshes that deform, a lattice of smoke whose values change, a scan, balls, and captured splats."""

    def bent(mesh: Mesh) -> Mesh:
        stretched = (mesh.position * (1, 1, 1 + 0.2 * shape)).astype(np.float32)
        return replace(mesh, key=f"{mesh.key} {shape}", position=stretched, topology=mesh.key)

    index = np.stack(np.meshgrid(*[np.arange(12)] * 3, indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    values = np.random.default_rng(shape).random(len(index)).astype(np.float32)
    smoke = Volume(f"smoke {shape}", "Smoke", index, np.diag([0.15, 0.15, 0.15, 1.0]), {"density": values})
    scan = replace(clouds.sphere_cloud(6000), radii=np.full((6000, 1), 0.02, np.float32))
    rng = np.random.default_rng(8)
    balls = replace(scan, normal=None, color=rng.random((6000, 3)).astype(np.float32))
    return (
        build.mesh(bent(meshes.sphere_mesh("bent ball", 24))),
        build.mesh(bent(meshes.cube_mesh("bent cube")), "POINTS"),
        Geometry(f"smoke {shape}", "Smoke", volume=smoke, lattice="smoke's voxels"),
        build.points("scan", scan),
        build.points("balls", balls),
        build.captured("captured", captured_sphere(20000)),
    )


def scene(frame: int) -> Scene:
    """Smoke lies over all the rest. The last frame shows the shapes of the one before."""
    kinds = geometries(min(frame, FRAMES - 2))
    places = [(x, y, 0.0) for y in (0.0, 2.5) for x in (-2.5, 0.0, 2.5)]
    return build.scene(*((kind, build.moved(place)) for kind, place in zip(kinds, places, strict=True)))


def pictures(technique: str, frames: range, away: float) -> dict[str, np.ndarray]:
    """The last of some frames, by one renderer that has drawn nothing before."""
    renderer = Renderer(drawing.opengl().device, Store())
    renderer.costs = drawing.CHEAP_POINTS
    given = Settings(technique=technique, shadow_resolution=64)
    for frame in frames:
        turn = TURN if frame == FRAMES - 1 else 0.0
        seen = cameras.camera((0.1, -(AWAY[frame] or away), 0.5), (turn, 0, 0), (64, 48), far=200.0)
        result = renderer.render(scene(frame), Request(seen, given, PASSES, 8))
    renderer.release()
    return result.pixels


@pytest.mark.parametrize("away", [20.0, 90.0])  # where draw orders nearly hold, and where nodes are drawn
@pytest.mark.parametrize("technique", ["AUTO", "VISIBILITY", "IMAGE_SPACE", "EWA", "PAINTER"])
def test_a_frame_is_the_same_alone_and_after_others(
    technique: str, away: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Octrees and nodes are for many splats: here they pay for few.
    monkeypatch.setattr(hierarchies, "BUILD_COST", 8)
    monkeypatch.setattr(hierarchies, "BALLS_PER_PIXEL", 1)
    monkeypatch.setattr(hierarchies, "BALL_TREE_COST", 1)
    monkeypatch.setattr(captured, "MIN_SPLATS", 1)
    monkeypatch.setattr(captured, "SPLATS_PER_PIXEL", 1.0)
    alone = pictures(technique, range(FRAMES - 1, FRAMES), away)
    after = pictures(technique, range(FRAMES), away)
    differ = {key: int((pixels != after[key]).any(axis=-1).sum()) for key, pixels in alone.items()}
    assert all(pixels.tobytes() == after[key].tobytes() for key, pixels in alone.items()), differ
