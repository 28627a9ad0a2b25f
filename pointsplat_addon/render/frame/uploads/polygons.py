"""Uploads of polygons: meshes, the baked pictures of their materials, and lists of the parts that instances draw."""

from __future__ import annotations

import numpy as np

from ....core.material.graph import MaterialGraph
from ....core.numeric.record import value_record
from ....core.scene.mesh import Mesh
from ....core.scene.scene import Geometry, Scene
from ....core.surface.appearance import digest, passing
from ....core.surface.density import Parts, coherent_order, make_parts
from ...cache.keys import Key, Kind
from ...cache.store import Store
from ...passes.visibility.polygon_mesh import PartList, Pictures, PolygonMesh, hang
from ...passes.visibility.polygon_page import MOST_TRIANGLES, PolygonPage
from ...passes.visibility.small_triangles import FEWEST_TRIANGLES
from ...plan.plan import Plan
from ...prepare.prepare import Prepared
from .instances import constants_key
from .scope import UploadScope


@value_record
class PageInScene:
    """A page, and which of its meshes each geometry of a scene is."""

    page: PolygonPage
    member: np.ndarray  # (G,) int64; -1: none of them


class PolygonUploads:
    """The meshes of one frame that are drawn as polygons."""

    def __init__(
        self,
        scope: UploadScope,
        store: Store,
        scene: Scene,
        prepared: Prepared,
        plan: Plan,
        whole_scene: Scene | None = None,
    ) -> None:
        """`whole_scene`: the one whose small meshes share pages, of which `scene` shows some; None: `scene` itself."""
        self._scope, self._store, self._scene, self._plan = scope, store, scene, plan
        self.meshes: dict[int, PolygonMesh] = {}  # by geometry row
        # By instance, of each group of its mesh: where it draws only some parts. None: the group has none of them.
        self.part_lists: dict[int, list[PartList | None]] = {}
        self.pages: list[PageInScene] = []  # of meshes that are in none of `meshes`
        if not plan.polygons:
            return
        rows = np.unique(scene.instances.geometry[prepared.polygons])
        if plan.sub_samples > 0:
            rows = self._add_pages(rows, page_members(whole_scene or scene))
        for row in rows.tolist():
            self.meshes[row] = self._mesh(row)
            hang(self.meshes[row].groups, self._pictures)
        for instance, parts in prepared.parts.items():
            groups = self.meshes[int(scene.instances.geometry[instance])].groups
            self.part_lists[instance] = [self._part_list(group.rows(parts)) for group in groups]

    def _add_pages(self, rows: np.ndarray, pages: list[list[Geometry]]) -> np.ndarray:
        """Adds those pages that geometries are on that polygons show, by their `rows`; returns the other rows."""
        keys = [geometry.key for geometry in self._scene.geometries]
        for members in pages:
            place = {geometry.key: number for number, geometry in enumerate(members)}
            member = np.array([place.get(key, -1) for key in keys])
            on_page = member[rows] >= 0
            if on_page.any():
                self.pages.append(PageInScene(self._page(members), member))
                rows = rows[~on_page]
        return rows

    def _page(self, members: list[Geometry]) -> PolygonPage:
        scene, plan = self._scene, self._plan
        meshes = [geometry.mesh for geometry in members if geometry.mesh is not None]
        content = tuple(geometry.key for geometry in members)
        looks = "/".join(digest(mesh, scene.materials) for mesh in meshes)
        more = (plan.variant, constants_key(scene), scene.materials.cull.tobytes())
        found = self._scope.lookup(
            Key(Kind.POLYGON_PAGE, content, looks, other=more),
            lambda: PolygonPage(self._scope.device, meshes, scene.materials, plan.variant),
        )
        hang(found.groups, self._pictures)
        return found

    def _mesh(self, row: int) -> PolygonMesh:
        scene, plan = self._scene, self._plan
        geometry = scene.geometries[row]
        mesh = geometry.mesh
        assert mesh is not None
        parts, whole = None, plan.sub_samples > 0  # the visibility buffer draws whole meshes
        if geometry.primitive == "AUTO" and not whole:
            parts = self._store.lookup(Key(Kind.PARTS, geometry.key), lambda: make_parts(mesh))
        more = (plan.variant, constants_key(scene), scene.materials.cull.tobytes(), parts is not None, whole)
        key = Key(Kind.POLYGON_MESH, geometry.key, digest(mesh, scene.materials), other=more)

        def make(mesh: Mesh = mesh, parts: Parts | None = parts) -> PolygonMesh:
            order = parts.order if parts is not None else coherent_order(mesh) if whole else None
            return PolygonMesh(self._scope.device, mesh, scene.materials, plan.variant, parts, order)

        return self._scope.lookup(key, make)

    def _pictures(self, graph: MaterialGraph, row: int) -> Pictures:
        """Returns the pictures of a graph, over constants of the material table's row."""
        table, emission = self._scene.materials, self._plan.variant.emission
        constants = (table.base_color[row].tobytes(), float(table.roughness[row]), float(table.metallic[row]))
        key = Key(Kind.TEXTURES, graph.digest, other=(*constants, emission))
        return self._scope.lookup(key, lambda: Pictures(self._scope.device, graph, table, row, emission))

    def _part_list(self, rows: np.ndarray) -> PartList | None:
        return PartList(self._scope.texture(rows), len(rows)) if len(rows) else None


def page_members(scene: Scene) -> list[list[Geometry]]:
    """Returns the geometries whose meshes share a page, for each page: opaque ones of few triangles.

    They do not depend on what a view shows of the scene. Meshes that compute shaders may draw have textures of their
    own, and so have those beside which there is no other.
    """
    uses = np.bincount(scene.instances.geometry, minlength=len(scene.geometries)).tolist()
    pages: list[list[Geometry]] = []
    held, seen = MOST_TRIANGLES, set()
    for geometry, count in zip(scene.geometries, uses, strict=True):
        mesh = geometry.mesh
        if mesh is None or count == 0 or geometry.key in seen or passing(mesh, scene.materials) is not None:
            continue
        triangles = len(mesh.triangles) * count
        if not 0 < triangles < FEWEST_TRIANGLES:
            continue
        seen.add(geometry.key)
        if held + triangles > MOST_TRIANGLES:
            pages.append([])
            held = 0
        pages[-1].append(geometry)
        held += triangles
    return [members for members in pages if len(members) > 1]
