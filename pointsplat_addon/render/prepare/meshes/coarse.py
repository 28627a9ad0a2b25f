"""Coarser meshes in place of those of which many triangles fall into a pixel wherever they are seen.

Corners move by a fraction of the distance between sub-samples: what a view draws of a mesh grows with its pixels, not
with its triangles.
"""

from __future__ import annotations

import math

import numpy as np

from ....core.lod.nodes.clusters import area, clustered
from ....core.numeric.lattice import MANY, lattice_for
from ....core.numeric.vectors import golden_ratio_sequence
from ....core.scene.mesh import Mesh
from ....core.surface.appearance import graphs_of, passing
from ...cache.keys import Key, Kind
from ..view import View
from .points import MeasuredMesh

EDGE = 1 / 3  # pixels of a cell, at most, with 17 sub-samples: of which one stands for 1/4 by 1/4
SIZES = 2  # of cells in an octave
FEWEST_TRIANGLES = 1 << 20  # of a mesh: fewer are drawn in no time
LEAST_SAVED = 2.0  # times the triangles of the coarser mesh, that the mesh has
TRIANGLES_PER_CELL = 3.0  # of the surface: 1.2 to 1.4 vertices in the area of a side of a cell
PLACES = 1 << 13  # vertices, and triangles, that are looked at: of them the nearest one
LEAST_AREA, MOST_AREA = 0.98, 1.05  # of the mesh: what is thinner than a cell is lost


def coarse_mesh(view: View, measured: MeasuredMesh, view_from_object: np.ndarray) -> Mesh | None:
    """Returns a coarser mesh that can be drawn in place of one, for all of its instances, (I, 4, 4) float64; None where
    it saves little or would be seen."""
    mesh, table, store = measured.mesh, view.scene.materials, view.store
    if len(mesh.triangles) < FEWEST_TRIANGLES or len(view_from_object) == 0 or view.blur is not None:
        return None
    if view.settings.use_indirect:  # indirect light would be found anew for each of them
        return None
    if mesh.objects or passing(mesh, table) is not None or graphs_of(mesh, table):
        return None
    flat, places, surface = store.lookup(Key(Kind.SURVEY, measured.geometry.key), lambda: _survey(mesh))
    if not flat and mesh.corner_normal is not None:
        return None
    few = min(lattice_for(view.samples, view.few).spacing / MANY.spacing, 2.0)
    allowed = few * EDGE * view.settings.tolerance * _pixel(view, places, view_from_object)
    diameter = 2 * measured.ball[1]
    if not 0 < allowed < diameter:
        return None
    edge = diameter * 2.0 ** (-math.ceil(SIZES * math.log2(diameter / allowed)) / SIZES)
    if LEAST_SAVED * TRIANGLES_PER_CELL * surface / edge**2 > len(mesh.triangles):
        return None

    def make() -> Mesh | None:
        view.check()
        found, whole = clustered(mesh, edge), area(mesh)
        return found if LEAST_AREA * whole <= area(found) <= MOST_AREA * whole else None

    key = Key(Kind.COARSE_MESH, measured.geometry.key, spacing=edge)
    if view.interactive and not store.made_later(key, make):
        return None  # until it is there
    return store.lookup(key, make)


def _survey(mesh: Mesh) -> tuple[bool, np.ndarray, float]:
    """Returns whether triangles have one normal each, some vertices, (n, 3) float64, and the area; by some of the
    triangles."""
    # Not by every n-th: divided meshes have parts of several sizes in turns.
    vertices, rows = (
        (golden_ratio_sequence(np.arange(min(PLACES, count))) * count).astype(np.int64)
        for count in (len(mesh.position), len(mesh.triangles))
    )
    normals = None if mesh.corner_normal is None else mesh.corner_normal[rows]
    flat = mesh.vertex_normal is None and (normals is None or bool((normals == normals[:, :1]).all()))
    return flat, mesh.position[vertices].astype(np.float64), area(mesh, rows)


def _pixel(view: View, places: np.ndarray, view_from_object: np.ndarray) -> float:
    """Returns what a pixel spans where some instance, (I, 4, 4), is nearest to the eye, in object units. places:
    (n, 3), of the mesh. What is beside the picture counts, too: its shadow may be in it."""
    camera = view.camera
    places = places[:: min(len(view_from_object), len(places))]
    linear = view_from_object[:, :3, :3]
    with np.errstate(all="ignore"):
        p = places @ linear.swapaxes(1, 2) + view_from_object[:, None, :3, 3]
        away = np.sqrt((p * p).sum(axis=2)) if camera.perspective else np.ones(p.shape[:2])
        scale = np.sqrt((linear * linear).sum(axis=(1, 2)) / 3)  # of instances that are stretched, the mean
        nearest = float((away / scale[:, None]).min())
    return nearest / max(abs(focal) for focal in camera.pixel_from_view()[:2])
