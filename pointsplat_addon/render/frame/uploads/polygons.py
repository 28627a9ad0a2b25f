"""Uploads of polygons: meshes, the baked pictures of their materials, and lists of the parts that instances draw."""

from __future__ import annotations

import numpy as np

from ....core.material.graph import MaterialGraph
from ....core.scene.mesh import Mesh
from ....core.scene.scene import Scene
from ....core.surface.appearance import digest
from ....core.surface.density import Parts, coherent_order, make_parts
from ...cache.keys import Key, Kind
from ...cache.store import Store
from ...passes.visibility.polygon_mesh import PartList, Pictures, PolygonMesh
from ...plan.plan import Plan
from ...prepare.prepare import Prepared
from .instances import constants_key
from .scope import UploadScope


class PolygonUploads:
    """The meshes of one frame that are drawn as polygons."""

    def __init__(self, scope: UploadScope, store: Store, scene: Scene, prepared: Prepared, plan: Plan) -> None:
        self._scope, self._store, self._scene, self._plan = scope, store, scene, plan
        self.meshes: dict[int, PolygonMesh] = {}  # by geometry row
        # By instance, of each group of its mesh: where it draws only some parts. None: the group has none of them.
        self.part_lists: dict[int, list[PartList | None]] = {}
        if not plan.polygons:
            return
        for row in np.unique(scene.instances.geometry[prepared.polygons]).tolist():
            self.meshes[row] = self._mesh(row)
            self.meshes[row].hang(self._pictures)
        for instance, parts in prepared.parts.items():
            groups = self.meshes[int(scene.instances.geometry[instance])].groups
            self.part_lists[instance] = [self._part_list(group.rows(parts)) for group in groups]

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
