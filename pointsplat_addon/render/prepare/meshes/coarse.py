"""Coarser meshes in place of those of which many triangles fall into a pixel wherever they are seen.

Corners move by a fraction of the distance between sub-samples: what a view draws of a mesh grows with its pixels, not
with its triangles. Shadows are those of the mesh itself.
"""

from __future__ import annotations

import math

import numpy as np

from ....core.lod.nodes.clusters import area, clustered
from ....core.numeric.lattice import MANY, lattice_for
from ....core.scene.mesh import Mesh
from ....core.surface.appearance import graphs_of, passing
from ...cache.keys import Key, Kind
from ..view import View
from .points import MeasuredMesh

EDGE = 1 / 3  # pixels of a cell, at most, with 17 sub-samples: of which one stands for 1/4 by 1/4
SIZES = 4  # of cells in an octave
FEWEST_TRIANGLES = 1 << 20  # of a mesh: fewer are drawn in no time
LEAST_SAVED = 2.0  # times the triangles of the coarser mesh, that the mesh has
TRIANGLES_PER_CELL = 3.0  # of the surface: 1.2 to 1.4 vertices in the area of a side of a cell
PLACES = 1 << 13  # vertices, and triangles, that are looked at: of them the nearest one in the picture
BESIDE = 0.1  # of the picture around it, in which vertices count
LEAST_AREA, MOST_AREA = 0.98, 1.05  # of the mesh: what is thinner than a cell is lost


def coarse_mesh(view: View, measured: MeasuredMesh, view_from_object: np.ndarray) -> Mesh | None:
    """Returns a coarser mesh that can be drawn in place of one, for all of its instances, (I, 4, 4) float64; None where
    it saves little or would be seen."""
    mesh, table, store = measured.mesh, view.scene.materials, view.store
    if len(mesh.triangles) < FEWEST_TRIANGLES or len(view_from_object) == 0 or view.blur is not None:
        return None
    if mesh.corner_normal is not None or mesh.objects or passing(mesh, table) is not None or graphs_of(mesh, table):
        return None
    places, surface = store.lookup(Key(Kind.SURVEY, measured.geometry.key), lambda: _survey(mesh))
    few = min(lattice_for(view.samples, view.interactive).spacing / MANY.spacing, 2.0)
    allowed = few * EDGE * view.settings.tolerance * _pixel(view, places, view_from_object)
    diameter = 2 * measured.ball[1]
    if not 0 < allowed < diameter:
        return None
    edge = diameter * 2.0 ** (-math.ceil(SIZES * math.log2(diameter / allowed)) / SIZES)
    if LEAST_SAVED * TRIANGLES_PER_CELL * surface / edge**2 > len(mesh.triangles):
        return None

    def make() -> Mesh | None:
        view.check()
        found = clustered(mesh, edge)
        return found if LEAST_AREA * surface <= area(found) <= MOST_AREA * surface else None

    key = Key(Kind.COARSE_MESH, measured.geometry.key, spacing=edge)
    if view.interactive and not store.made_later(key, make):
        return None  # until it is there
    return store.lookup(key, make)


def _survey(mesh: Mesh) -> tuple[np.ndarray, float]:
    """Returns some vertices, (n, 3) float64, and the area by some of the triangles."""
    places = mesh.position[:: max(len(mesh.position) // PLACES, 1)].astype(np.float64)
    return places, area(mesh, max(len(mesh.triangles) // PLACES, 1))


def _pixel(view: View, places: np.ndarray, view_from_object: np.ndarray) -> float:
    """Returns what a pixel spans where some instance, (I, 4, 4), is nearest in the picture, in object units; infinity
    where none is in it. places: (n, 3), of the mesh."""
    camera, (_, _, width, height) = view.camera, view.camera.window
    places = places[:: min(len(view_from_object), len(places))]
    linear = view_from_object[:, :3, :3]
    with np.errstate(all="ignore"):
        p = places @ linear.swapaxes(1, 2) + view_from_object[:, None, :3, 3]
        depth = -p[..., 2] if camera.perspective else np.ones(p.shape[:2])
        fx, fy, cx, cy = camera.pixel_from_view()
        x, y = p[..., 0] / depth * fx + cx, p[..., 1] / depth * fy + cy
        inside = (np.abs(x / width - 0.5) < 0.5 + BESIDE) & (np.abs(y / height - 0.5) < 0.5 + BESIDE)
        inside &= ~(depth < camera.near)
        scale = np.sqrt((linear * linear).sum(axis=(1, 2)) / 3)  # of instances that are stretched, the mean
        nearest = np.where(inside, depth / scale[:, None], np.inf).min()
    return float(nearest) / max(abs(fx), abs(fy))
