"""The far side of a closed surface does not show between the splats of its near side."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.mesh import Mesh
from scripts.scenes import build, cameras, drawing, meshes
from scripts.scenes.case import Case

DEPTH = frozenset({"depth"})
BEHIND = 0.1  # depth by which a speck lies behind all pixels beside it
SPACING = 0.008  # 1.5 pixels where the surface is nearest: as far as splats lie apart at the default tolerance


def bumpy_sphere(key: str, rings: int) -> Mesh:
    """Many slopes that are seen at grazing angles, in front of others."""
    mesh = meshes.sphere_mesh(key, rings)
    x, y, z = mesh.position.T
    position = mesh.position * (1 + 0.04 * np.sin(9 * x) * np.cos(7 * y) + 0.02 * np.sin(31 * z))[:, None]
    corners = position[mesh.triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = np.zeros_like(position)
    for corner in range(3):
        np.add.at(normal, mesh.triangles[:, corner], face)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return replace(mesh, position=position.astype(np.float32), vertex_normal=normal.astype(np.float32))


def specks(depth: np.ndarray) -> int:
    """Pixels that lie far behind the four beside them, all of which show something."""
    beside = np.stack([np.roll(depth, step, axis) for axis in (0, 1) for step in (-1, 1)])
    return int(((depth > beside.max(axis=0) + BEHIND) & (depth < 100) & (beside < 100).all(axis=0)).sum())


@pytest.mark.parametrize("eye", [(0, -4, 0), (2.5, -3, 1), (0.3, -3, 2.6)])
def test_one_sample_shows_hardly_a_speck(eye):
    mesh = bumpy_sphere("specks", 60)
    scene = build.scene((build.mesh(mesh, "POINTS", spacing=SPACING), np.eye(4)))
    camera = cameras.camera(eye=eye, resolution=(400, 400))
    depth = drawing.render(Case(scene, camera), DEPTH).pixels["depth"][..., 0]
    assert (depth < 100).sum() > 60000
    assert specks(depth) <= 2  # measured 1; 50 where only what splats touch counts as hidden
