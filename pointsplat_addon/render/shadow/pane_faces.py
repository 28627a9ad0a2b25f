"""Panes met exactly: their faces, at which each receiver looks through each point of a light with a size.

From a receiver, a face covers what of the light lies within its edges: a polygon in the plane of the light, so that
shadows are as sharp or as soft as they are, with neither texels nor samples. That takes time for each face, and so
there are few of them; where there are more, tables hold them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.numeric.record import record
from ...core.numeric.segments import ranks
from ...core.scene.lights import Light
from ...core.scene.mesh import Mesh
from ...core.scene.scene import Scene
from ..cache.keys import Key, Kind
from ..cache.keys import digest as hashed
from ..cache.store import Store
from .casting import CastingGeometry, caster_keys, light_key
from .light_points import light_shape
from .maps import takes_map
from .panes import pane_shares

MOST_FACES = 64  # bits of the two words in which shaders keep those that cover a light in part
FLAT = 1e-6  # of lengths: how far corners of one face may lie from a plane
SAME_PLANE = 1e-4  # of normals and of a mesh's extent: faces of one sheet
TEXELS = 4  # of a light, and of a face


@record
class PaneFaces:
    """The faces of all panes in the world, and the lights that they shade."""

    key: Key
    lights: tuple[Light | None, ...]  # in the order of the light table's rows; None: it looks at none
    corners: np.ndarray  # (F, 4, 3) float64, around each face; of triangles the last one twice
    through: np.ndarray  # (F, 3) float32, share of light
    sheet: np.ndarray  # (F,) rising integers: faces with the same number do not overlap

    @property
    def colored(self) -> bool:
        """Whether some face lets more of one channel through than of another."""
        return bool((self.through != self.through[:, :1]).any())

    def records(self, view_from_world: np.ndarray) -> np.ndarray:
        """Returns ps_pane_faces, float32 texels of four, for a view, (4, 4) float64, rigid.

        A row for each light: its middle, or the direction towards a sun, and 1 for suns, 2 for others, 0 where it
        looks at no face; half-axes of its outline, with whether it is a rectangle, and whether it faces receivers;
        where faces begin, and how many they are. Then one for each face: its corners, with the shares of light that
        pass, and the number of its sheet.
        """
        turn, move = view_from_world[:3, :3], view_from_world[:3, 3]
        found = np.zeros((len(self.lights) + len(self.corners), TEXELS, 4))
        for row, light in zip(found, self.lights, strict=False):
            shape = None if light is None else light_shape(light)
            if light is None or shape is None:
                continue
            sun = light.kind == "SUN"
            row[0] = *(turn @ -light.direction if sun else turn @ light.position + move), 1 if sun else 2
            row[1:3, :3] = shape.axes @ turn.T
            row[1:3, 3] = shape.rectangle, shape.facing
            row[3, :2] = len(self.lights), len(self.corners)
        faces = found[len(self.lights) :]
        faces[..., :3] = self.corners @ turn.T + move
        faces[:, :3, 3], faces[:, 3, 3] = self.through, self.sheet
        return found.astype(np.float32)


def takes_faces(light: Light) -> bool:
    """Tells whether a light may look at faces of panes: where it has a place and a size."""
    return takes_map(light) and light_shape(light) is not None


def make_faces(
    scene: Scene, lights: Sequence[Light], casters: Sequence[CastingGeometry], store: Store
) -> PaneFaces | None:
    """Returns the faces of casters that are panes, for those of `lights` that take faces; None where there are no such
    lights, no faces, or too many."""
    chosen = tuple(light if takes_faces(light) else None for light in lights)
    triangles = sum(len(c.geometry.mesh.triangles) * len(c.matrices) for c in casters if c.geometry.mesh is not None)
    if not 0 < triangles <= 2 * MOST_FACES or not any(chosen):
        return None
    look = tuple(caster_keys(scene, casters))
    key = Key(Kind.PANE_FACES, hashed((look, tuple(None if light is None else light_key(light) for light in chosen))))

    def make() -> PaneFaces | None:
        shares = np.broadcast_to(pane_shares(scene.materials), (len(scene.materials), 3))
        parts = [_faces(caster, matrix, shares) for caster in casters for matrix in caster.matrices]
        corners, through, begins = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        sheet = np.cumsum(begins)
        return PaneFaces(key, chosen, corners, through, sheet) if 0 < len(corners) <= MOST_FACES else None

    return store.lookup(key, make)


def _faces(
    caster: CastingGeometry, matrix: np.ndarray, shares: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns corners and shares of light of one instance's faces, as in PaneFaces, and which are the first of their
    sheets, (F,) bool. shares (M, 3): of each material."""
    mesh = caster.geometry.mesh
    assert mesh is not None
    one = np.full(len(mesh.triangles), mesh.materials[0], np.int64)
    material = one if mesh.material is None else mesh.material.astype(np.int64)
    index, material = convex_faces(mesh, material)
    shown = (shares[material] < 1).any(axis=1)
    index, material = index[shown], material[shown]
    corners = mesh.position[index].astype(np.float64)
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    extent = max(float(np.ptp(mesh.position, axis=0).max(initial=0.0)), 1e-300)
    offset = np.einsum("fc,fc->f", normal, corners[:, 0] - mesh.position.mean(axis=0)) / extent
    plane = np.round(np.column_stack([normal, offset]) / SAME_PLANE)
    _, sheet = np.unique(np.column_stack([material, plane]), axis=0, return_inverse=True)
    order = np.argsort(sheet.ravel(), kind="stable")
    sheet = sheet.ravel()[order]
    begins = np.append(True, sheet[1:] != sheet[:-1])[: len(sheet)]
    return corners[order] @ matrix[:3, :3].T + matrix[:3, 3], shares[material[order]], begins


def convex_faces(mesh: Mesh, material: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joins triangles of a mesh that follow each other to convex quadrilaterals, as Blender's were before they were
    divided. Returns their vertices (F, 4), of other triangles the last one twice, and their materials (F,).

    material: (T,) of the triangles.
    """
    triangles = mesh.triangles.astype(np.int64)
    whole = np.column_stack([triangles, triangles[:, 2]])
    if len(triangles) < 2:
        return whole, material
    first, second = triangles[:-1], triangles[1:]
    shared = first[:, :, None] == second[:, None, :]
    # The first triangle's vertices from the one on that the second lacks, and the second's that the first lacks.
    start = (~shared.any(axis=2)).argmax(axis=1)
    turned = np.take_along_axis(first, (start[:, None] + np.arange(3)) % 3, axis=1)
    other = np.take_along_axis(second, (~shared.any(axis=1)).argmax(axis=1)[:, None], axis=1)
    quad = np.column_stack([turned[:, :2], other, turned[:, 2]])
    corners = mesh.position[quad].astype(np.float64)
    edge = np.roll(corners, -1, axis=1) - corners
    turn = np.cross(np.roll(edge, 1, axis=1), edge)
    normal = turn.sum(axis=1)
    size = np.linalg.norm(normal, axis=1)
    height = np.abs(np.einsum("fc,fc->f", normal, corners[:, 2] - corners[:, 0])) / np.maximum(size, 1e-300)
    joined = (shared.sum(axis=(1, 2)) == 2) & (material[:-1] == material[1:])
    joined &= (np.einsum("fkc,fc->fk", turn, normal) > 0).all(axis=1) & (height <= FLAT * np.sqrt(size))
    # Of those that could be joined with both neighbours, every other pair.
    run = np.flatnonzero(np.diff(np.concatenate([[False], joined, [False]]).astype(int)))
    begin, length = run[::2], run[1::2] - run[::2]
    pair = (np.repeat(begin, length) + ranks(length))[ranks(length) % 2 == 0]
    rest = np.setdiff1d(np.arange(len(triangles)), np.concatenate([pair, pair + 1]))
    return np.concatenate([quad[pair], whole[rest]]), np.concatenate([material[pair], material[rest]])
