"""Uploads of polygons: meshes, the baked pictures of their materials, and lists of the parts that instances draw."""

from __future__ import annotations

import functools

import numpy as np

from ....core.numeric.lattice import lattice_of
from ....core.numeric.record import value_record
from ....core.scene.camera import Camera
from ....core.scene.mesh import Mesh
from ....core.scene.scene import Geometry, Scene
from ....core.surface.appearance import baked, digest, passing
from ....core.surface.density import Parts, coherent_order, make_parts
from ...cache.keys import Key, Kind
from ...cache.store import Store
from ...device.protocol import Texture
from ...passes.visibility.pictures import LARGEST_PICTURE, Levels, Pictures
from ...passes.visibility.polygon_mesh import Group, PartList, PolygonMesh
from ...passes.visibility.polygon_page import MOST_TRIANGLES, PolygonPage
from ...passes.visibility.polygon_page import Kind as PageKind
from ...passes.visibility.small_triangles import FEWEST_TRIANGLES
from ...plan.plan import Plan
from ...prepare.prepare import Prepared
from .instances import constants_key
from .scope import UploadScope

# How many times longer than wide footprints are that matter: of surfaces seen at 7 degrees and more.
LONGEST = 8.0


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
        camera: Camera | None = None,
        whole_scene: Scene | None = None,
    ) -> None:
        """`camera`: of the picture, whose pixels show pictures; None: only depths are drawn.

        `whole_scene`: the one whose small meshes share pages, of which `scene` shows some; None: `scene` itself.
        """
        self._scope, self._store, self._scene, self._plan = scope, store, scene, plan
        self._prepared, self._camera = prepared, camera
        self.meshes: dict[int, PolygonMesh] = {}  # by geometry row
        # By instance, of each group of its mesh: where it draws only some parts. None: the group has none of them.
        self.part_lists: dict[int, list[PartList | None]] = {}
        self.pages: list[PageInScene] = []  # of meshes that are in none of `meshes`
        if not plan.polygons:
            return
        rows = np.unique(scene.instances.geometry[prepared.all_polygons])
        if plan.sub_samples > 0:
            rows = self._add_pages(rows, page_members(whole_scene or scene))
        for row in rows.tolist():
            self.meshes[row] = self._mesh(row)
        for instance, parts in prepared.parts.items():
            groups = self.meshes[int(scene.instances.geometry[instance])].groups
            self.part_lists[instance] = [self._part_list(group.rows(parts)) for group in groups]

    def _add_pages(self, rows: np.ndarray, pages: list[list[Geometry]]) -> np.ndarray:
        """Adds those pages that geometries are on that polygons show, by their `rows`; returns the other rows."""
        place = {one.key: (page, number) for page, members in enumerate(pages) for number, one in enumerate(members)}
        page_of, number = np.array([place.get(one.key, (-1, -1)) for one in self._scene.geometries]).reshape(-1, 2).T
        for page in np.unique(page_of[rows]).tolist():
            if page >= 0:
                member = np.where(page_of == page, number, -1)
                self.pages.append(PageInScene(self._page(pages[page], member), member))
        return rows[page_of[rows] < 0]

    def _page(self, members: list[Geometry], member: np.ndarray) -> PolygonPage:
        scene, plan = self._scene, self._plan
        meshes = [geometry.mesh for geometry in members if geometry.mesh is not None]
        content = tuple(geometry.key for geometry in members)
        looks = "/".join(digest(mesh, scene.materials) for mesh in meshes)
        more = (plan.variant.emission, constants_key(scene), scene.materials.cull.tobytes())
        page: PolygonPage = self._scope.lookup(
            Key(Kind.POLYGON_PAGE, content, looks, other=more),
            lambda: PolygonPage(self._scope.device, meshes, scene.materials, plan.variant.emission),
        )

        @functools.cache
        def shown() -> tuple[np.ndarray, np.ndarray]:
            """Which of its meshes each instance on the page is, and what sub-samples span there."""
            shown = self._prepared.polygons
            which = member[scene.instances.geometry[shown]]
            here, which = shown[which >= 0], which[which >= 0]
            return which, self._spans(here, page.origin[which], page.box[which])

        def pictures(kind: PageKind) -> dict[str, Texture]:
            which, spans = shown()
            return self._pictures(kind.group, spans * kind.stretch[which])

        return page.with_pictures(pictures)

    def _mesh(self, row: int) -> PolygonMesh:
        scene, plan = self._scene, self._plan
        geometry = scene.geometries[row]
        mesh = geometry.mesh
        assert mesh is not None
        parts, whole = None, plan.sub_samples > 0  # the visibility buffer draws whole meshes
        if geometry.primitive == "AUTO" and not whole:
            parts = self._store.lookup(Key(Kind.PARTS, geometry.key), lambda: make_parts(mesh))
        translucent = passing(mesh, scene.materials) is not None
        more = (plan.variant.emission, constants_key(scene), scene.materials.cull.tobytes(), parts is not None, whole)
        key = Key(Kind.POLYGON_MESH, geometry.key, digest(mesh, scene.materials), other=more)

        def make(mesh: Mesh = mesh, parts: Parts | None = parts) -> PolygonMesh:
            order = parts.order if parts is not None else coherent_order(mesh) if whole else None
            return PolygonMesh(
                self._scope.device, mesh, scene.materials, plan.variant.emission, parts, order, whole, translucent
            )

        found: PolygonMesh = self._scope.lookup(key, make)
        here = self._prepared.polygons[scene.instances.geometry[self._prepared.polygons] == row]
        spans = functools.cache(lambda: self._spans(here, found.origin, found.box))
        return found.with_pictures(lambda group: self._pictures(group, spans() * group.stretch))

    def _spans(self, instances: np.ndarray, origin: np.ndarray, box: np.ndarray) -> np.ndarray:
        """Units of object space that a sub-sample spans at most where a surface faces the eye, of instances (I,).

        origin: (3,) or (I, 3). box: (2, 3) or (I, 2, 3), relative to it.
        """
        if self._camera is None:
            return np.zeros(len(instances))
        spacing = lattice_of(self._plan.sub_samples).spacing if self._plan.sub_samples else 1.0
        matrices = self._prepared.view_from_object[instances]
        return spacing * _widest_pixels(matrices, origin, box, self._camera)

    def _pictures(self, group: Group, spans: np.ndarray) -> dict[str, Texture]:
        """Returns the pictures of a group, over constants of its row of the material table, with their smaller levels
        where sub-samples may span a texel. spans: (I,) of UV, that sub-samples of instances span where they face the
        eye."""
        assert group.graph is not None
        graph, row, scope = group.graph, group.material, self._scope
        table, emission = self._scene.materials, self._plan.variant.emission
        constants = (table.base_color[row].tobytes(), float(table.roughness[row]), float(table.metallic[row]))
        picture = functools.cache(lambda: baked(graph, LARGEST_PICTURE))

        spread = self._plan.variant.spread and not {"PS_BAKED_NORMAL", "PS_BAKED_HEIGHT"}.isdisjoint(group.defines)

        def textures(kind: type[Pictures | Levels], *more: bool) -> dict[str, Texture]:
            key = Key(Kind.TEXTURES, graph.digest, other=(*constants, emission, kind.__name__, *more))
            return scope.lookup(key, lambda: kind(scope.device, graph, picture(), table, row, emission, *more)).textures

        found = textures(Pictures)
        texels = max(max(texture.size) for texture in found.values())
        if spans.max(initial=0) * texels * LONGEST <= 1:
            return found
        return {**found, **textures(Levels, spread)}

    def _part_list(self, rows: np.ndarray) -> PartList | None:
        return PartList(self._scope.texture(rows), len(rows)) if len(rows) else None


def _widest_pixels(view_from_object: np.ndarray, origin: np.ndarray, box: np.ndarray, camera: Camera) -> np.ndarray:
    """(I,) units of object space that a pixel spans at most, where a surface faces the eye, of instances (I, 4, 4).
    0: nothing is seen of it."""
    linear = view_from_object[:, :3, :3]
    with np.errstate(all="ignore"):
        depth = np.ones(len(linear))
        if camera.perspective:
            middle = np.einsum("iab,ib->ia", linear, np.broadcast_to(origin + box.mean(axis=-2), (len(linear), 3)))
            extent = np.einsum("iab,ib->ia", linear, np.broadcast_to(box[..., 1, :] - box[..., 0, :], (len(linear), 3)))
            depth = 0.5 * np.linalg.norm(extent, axis=1) - middle[:, 2] - view_from_object[:, 2, 3]
        a, b, c = linear.transpose(2, 0, 1)
        inverse = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
        inverse /= np.einsum("ia,ia->i", a, inverse[:, 0])[:, None, None]
        # Of all directions, which transforms that turn and scale change alike.
        wide = np.linalg.norm(inverse, axis=(1, 2)) / 3**0.5
        found = np.maximum(depth, 0) * wide / min(camera.pixel_from_view()[:2])
    return np.where(np.isfinite(found), found, 0.0)


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
