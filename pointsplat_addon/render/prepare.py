"""What of a scene is drawn as points and what as polygons, how densely sampled, and which cut of it: numpy only.

Clouds and hierarchies depend on the geometry, its materials and an octave of spacing; they are kept in a `Store` that
all views and frames share. Only the cut depends on the view.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ..core import sampling
from ..core.apart import apart, leafy
from ..core.appearance import digest, passing, point_cloud
from ..core.cloud import PointCloud, coherent, finite
from ..core.cost import DEFAULT, Costs
from ..core.cut import Cut, Forest, all_finite, forest, fully, largest_singular_value, select, staggered
from ..core.defocus import COARSEST, NODE, blur_of
from ..core.hierarchy import Hierarchy, recolor, refit
from ..core.instances import ALL, NONE, OWN, Levels, choose, cut_of, enlarged, joined, make_levels, visible
from ..core.lens import sampled
from ..core.scene import Camera, Geometry, MaterialTable, Mesh, Scene, Settings
from ..core.spacing import EXACT_INSTANCES, PART, make_parts, required_spacing
from ..core.strands import NEAREST, Segments, clean, together
from ..core.strands import select as select_segments
from ..core.vectors import dot, each_block
from .blurred import Blurred, Focus
from .hybrid import Divided, PartSamples, Shown, sample_parts, show
from .store import STORE, Layer, PointSet, Store

# Of meshes whose instances are many, AUTO draws polygons where the typical triangle's edge spans more pixels than this.
POLYGON_PIXELS = 4.0
MOST_LEAVES = 1 << 21  # triangles of all instances of a mesh of leaves, which AUTO draws as polygons from any distance
HIERARCHY_PAYS = 80  # building costs about as much as drawing the points this many times
BLENDED = 10  # times what a small splat costs in image space, it costs by EWA, where it covers more than its pixel
SMALL_SPLAT = 0.25  # of the tolerance: where typical splats are smaller, most of a cloud can be left out
# The same where instances are many, for finding what they draw costs nothing for each splat, and by EWA.
SMALL_SHARED = 0.5
EXACT_TRIANGLES = 4 << 20  # of all instances: so many are asked one by one what they need
WIDE_BALL = 2.0  # pixels of radius: means of wider balls that overlap would show
MANY_TRIANGLES = 1 << 14  # of one mesh: fewer are all looked at in no time
FEW_POINTS = 1 << 12  # blurred points without nodes cost less than nodes do
MANY_INSTANCES = 16  # of one hierarchy: so many share cuts
SHARED_CELLS = 128  # samples across a geometry whose instances are many: outlines grow by half a percent
MOST_BARE = 1 << 24  # splats of all instances together: what draws more waits for its hierarchy
COARSEST_OCTAVE = 6  # beyond it, the few samples that are left cost less than another cloud
VERTEX_PIXELS = 2.0  # vertices are samples enough where no edge spans more; with pictures on them, one sample a pixel


@dataclass(frozen=True, eq=False)
class Prepared(Layer):
    """What one view draws: opaque points, polygons, and translucent points."""

    translucent: Layer
    spheres: Layer  # balls so wide on the screen that each is drawn by itself
    polygons: np.ndarray  # (P,) int: instances that are drawn as polygons
    view_from_object: np.ndarray  # (I, 4, 4) float64
    largest: float  # upper bound of a drawn splat's projected radius in pixels
    total: int  # points of all instances, before any cut
    warnings: tuple[str, ...] = ()
    # By instance: the parts (core/spacing.py) that are drawn as polygons, rising; absent: all.
    parts: dict[int, np.ndarray] = field(default_factory=dict)
    lines: dict[int, Segments] = field(default_factory=dict)  # segments of strands, by geometry row
    blurred: Blurred | None = None  # what is out of focus; all else then holds what is not
    # Where `translucent` holds what is out of focus, too, of its sets what of its ellipse each splat covers.
    shares: dict[int, np.ndarray | float] = field(default_factory=dict)


def prepare(
    scene: Scene,
    camera: Camera,
    settings: Settings,
    samples: int,
    store: Store = STORE,
    *,
    interactive: bool = False,
    check: Callable[[], None] = lambda: None,
    costs: Costs = DEFAULT,
    node: float = NODE,
) -> Prepared:
    """Choose, sample and cut everything that `camera` sees.

    `samples` tells how often the result will be drawn. `interactive`: again and again, and at once; what takes long is
    then built on another thread and used when it is there. `check` is called between geometries, and may raise to stop.
    `costs`: what drawing costs on the device. `node`: of what is out of focus, see core/defocus.py.
    """
    return _View(scene, camera, settings, samples, interactive, store, check, costs, node).prepared()


@dataclass
class _View:
    scene: Scene
    camera: Camera
    settings: Settings
    samples: int
    interactive: bool
    store: Store
    check: Callable[[], None]
    costs: Costs
    node: float
    warnings: list[str] = field(default_factory=list)
    ranges: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)  # of points, by instance
    parts: dict[int, np.ndarray] = field(default_factory=dict)  # that are polygons, by instance
    focus: Focus | None = None  # something may be out of it

    def prepared(self) -> Prepared:
        scene, camera, instances = self.scene, self.camera, self.scene.instances
        with np.errstate(all="ignore"):
            view_from_object = camera.view_from_world @ instances.world_from_object
            usable = all_finite(view_from_object.astype(np.float32))  # as the device has them
        blur = blur_of(camera, self.node) if self.settings.dof_method == "SPLAT" else None
        if blur is not None:
            tolerance = min(self.settings.tolerance, COARSEST)
            self.focus = Focus(scene, camera, blur, tolerance, self.store, view_from_object)
        opaque, translucent, spheres = (({}, np.full(len(instances), -1)) for _ in range(3))
        polygons: list[np.ndarray] = []
        # Parts of meshes are all points or all polygons where either may be out of focus.
        divided = {} if self.focus else self._divided(view_from_object, usable)
        lines = self._lines(view_from_object, usable)
        for row, geometry in enumerate(scene.geometries):
            where = np.flatnonzero(usable & (instances.geometry == row))
            if len(where) == 0 or geometry.lines is not None:
                continue
            self.check()
            if row in divided:
                shown = divided[row]
                found, with_polygons = self._by_parts(geometry, where, shown)
                whole = np.flatnonzero([s is not None and s.whole for s in shown])
                if len(whole):
                    every = self._all_points(geometry, view_from_object[where[whole]])
                    found += [(points, whole[some]) for points, some in every]
                polygons.append(with_polygons)
            else:
                found = self._points(geometry, view_from_object[where])
            if found is None:
                near = self._near(geometry, view_from_object[where])
                polygons.append(where[near])
                where = where[~near]
                # What is not near is small enough to be points, each instance by itself.
                found = self._points(geometry, view_from_object[where], all_far=True) if len(where) else []
                if found is None:
                    polygons.append(where)
                    continue
            point_sets, set_of_instance = translucent if lets_through(geometry, scene.materials) else opaque
            for number, (points, some) in enumerate(found):
                if len(points) == 0:
                    continue
                wide = self._wide(points, view_from_object[where[some]]) & (point_sets is opaque[0])
                if wide.any():
                    spheres[0][row] = points
                    spheres[1][where[some[wide]]] = row
                    some = some[~wide]
                if len(some):
                    key = row if number == 0 else len(scene.geometries) + len(point_sets)
                    split = any(instance in self.parts for instance in where[some].tolist())
                    point_sets[key] = points if split else self._with_hierarchy(points, view_from_object[where[some]])
                    set_of_instance[where[some]] = key
        total = sum(int(_counts(sets)[which].sum()) for sets, which in (opaque, translucent, spheres))
        drawn = np.concatenate(polygons) if polygons else np.empty(0, np.int64)
        if self.focus is not None:
            drawn = self._focused(self.focus, opaque, spheres, drawn)
        largest = _largest(opaque[1], opaque[0], view_from_object, camera, self.store)
        layer = self._layer(*opaque, view_from_object, "SHARP")
        behind = self._layer(*translucent, view_from_object, "ALL")
        largest = max(largest, self.settings.tolerance if layer.cut.nodes else 0.0)
        balls = Layer(*spheres, fully(_counts(spheres[0]), spheres[1]))
        return Prepared(
            layer.point_sets,
            layer.set_of_instance,
            layer.cut,
            behind,
            balls,
            drawn,
            view_from_object,
            largest,
            total,
            tuple(dict.fromkeys(self.warnings)),
            self.parts,
            lines,
            self._blurred(behind),
        )

    def _blurred(self, behind: Layer) -> Blurred | None:
        """What is out of focus, if anything is, or what is translucent may be."""
        found = self.focus.layer() if self.focus is not None else None
        return found if found is not None and (found.cut.splats or behind.cut.splats) else None

    def _focused(
        self,
        focus: Focus,
        opaque: tuple[dict[int, PointSet], np.ndarray],
        spheres: tuple[dict[int, PointSet], np.ndarray],
        polygons: np.ndarray,
    ) -> np.ndarray:
        """Gives `focus` what may be out of focus of all that is opaque, and takes out of the others what is so as a
        whole. Returns the polygons (P,) that are left."""
        geometries, geometry_of = self.scene.geometries, self.scene.instances.geometry
        for sets, set_of_instance in (opaque, spheres):
            for key, points in list(sets.items()):
                where = np.flatnonzero(set_of_instance == key)
                middle, far, radius = _extent(points, self.store)
                inside, outside = focus.reaches(where, middle, far + radius)
                if outside.any() and sets is spheres[0]:
                    focus.add_balls(where[outside], points)
                elif outside.any():
                    areas = self._areas(geometries[geometry_of[where[0]]], points)
                    sets[key] = points = self._with_nodes(points, always=areas is None)
                    focus.add_points(where[outside], points, areas)
                set_of_instance[where[~inside]] = -1
                if not inside.any():
                    del sets[key]
        kept = []
        for row in np.unique(geometry_of[polygons]).tolist():
            geometry, where = geometries[row], polygons[geometry_of[polygons] == row]
            mesh = geometry.mesh
            assert mesh is not None
            ok = self._valid(geometry, mesh)
            middle, radius = self.store.lookup(("bounds", geometry.key), lambda mesh=mesh, ok=ok: _bounds(mesh, ok))
            inside, outside = focus.reaches(where, middle, radius)
            self.check()
            focus.add_mesh(where[outside], geometry, mesh, ok)
            kept.append(where[inside])
        return np.concatenate([np.empty(0, np.int64), *kept])

    def _with_nodes(self, points: PointSet, always: bool) -> PointSet:
        """Points with a hierarchy, where they are so many that blurred ones are worth leaving out, or `always`."""
        if points.hierarchy is not None or (len(points.cloud) < FEW_POINTS and not always):
            return points
        points, store = self._filled(points), self.store
        key = ("hierarchy", *points.key)
        return replace(points, key=key, hierarchy=store.lookup(key, lambda: _hierarchy(points, store)))

    def _areas(self, geometry: Geometry, points: PointSet) -> Callable[[], np.ndarray] | None:
        """What each sample of a mesh stands for, in object units squared; None: it is not known."""
        mesh, key = geometry.mesh, points.key
        while key and key[0] in ("hierarchy", "filled"):
            key = key[1:-1] if key[0] == "filled" else key[1:]
        if mesh is None or not key or key[0] != "samples":
            return None
        _, _, _, method, spacing = key
        shape = (mesh.topology or geometry.key, geometry.name)
        if ("places", shape, method, spacing) not in self.store:
            return None
        samples, _ = self.store.lookup(("places", shape, method, spacing), lambda: None)
        if len(samples) != len(points.cloud):
            return None
        ok = self._valid(geometry, mesh)
        return lambda: sampling.areas(mesh, samples, ok)

    def _lines(self, view_from_object: np.ndarray, usable: np.ndarray) -> dict[int, Segments]:
        """The segments of strands that this view draws, by geometry row."""
        found: dict[int, Segments] = {}
        for row, geometry in enumerate(self.scene.geometries):
            lines = geometry.lines
            where = np.flatnonzero(usable & (self.scene.instances.geometry == row))
            if lines is None or len(where) == 0:
                continue
            self.check()
            strands = self.store.lookup(("strands", geometry.key), lambda lines=lines: clean(lines))
            self.warnings += [f"{geometry.name}: {message}" for message in strands.messages]
            if len(strands) == 0:
                continue
            tolerance = self.settings.tolerance
            parts = [select_segments(strands, view_from_object[i], i, self.camera, tolerance) for i in where.tolist()]
            parts = [part for part in parts if len(part)]
            if parts:
                found[row] = together(parts)
                if self.focus is not None:
                    found[row] = self.focus.add_lines(geometry, lines, strands, found[row])
                    found = {row: segments for row, segments in found.items() if len(segments)}
        return found

    def _divided(self, view_from_object: np.ndarray, usable: np.ndarray) -> dict[int, list[Shown | None]]:
        """Meshes that are chosen for part by part, by row, with each usable instance's choice. Where points would save
        less than the passes over all pixels cost that they need, all are polygons."""
        found: dict[int, list[Shown | None]] = {}
        scene, others = self.scene, False
        for row, geometry in enumerate(scene.geometries):
            views = view_from_object[usable & (scene.instances.geometry == row)]
            mesh = geometry.mesh
            if len(views) == 0 or geometry.lines is not None or (mesh is not None and len(mesh.triangles) == 0):
                continue
            if mesh is None or not self._choosable(geometry, mesh, len(views)):
                others |= geometry.primitive != "POLYGONS" and not lets_through(geometry, scene.materials)
                continue
            self.check()
            found[row] = self._shown(geometry, mesh, views)
        choices = [s.choice for some in found.values() for s in some if s is not None]
        pixels = self.costs.pixel * float(np.prod(self.camera.window[2:]))
        if not others and sum(c.triangles_cost - c.cost for c in choices) < pixels:
            found = {row: [None if s is None else s.as_polygons() for s in some] for row, some in found.items()}
        return found

    def _choosable(self, geometry: Geometry, mesh: Mesh, instances: int) -> bool:
        if geometry.primitive != "AUTO" or geometry.spacing > 0 or instances >= MANY_INSTANCES:
            return False
        ok = self._valid(geometry, mesh)
        if not ok.any() or lets_through(geometry, self.scene.materials):
            return False
        return instances * len(mesh.triangles) > MOST_LEAVES or not self.store.lookup(
            ("leafy", geometry.key), lambda: leafy(mesh.position, mesh.triangles[ok])
        )

    def _valid(self, geometry: Geometry, mesh: Mesh) -> np.ndarray:
        """(T,) bool; says what is dropped."""
        ok, dropped = self.store.lookup(("valid", geometry.key), lambda: sampling.validate(mesh))
        if dropped.total:
            self.warnings.append(dropped.message(geometry.name))
        return ok

    def _division(self, geometry: Geometry, mesh: Mesh) -> Divided:
        ok = self._valid(geometry, mesh)

        def make() -> Divided:
            parts = self.store.lookup(("parts", geometry.key), lambda: make_parts(mesh, ok))
            measures = self.store.lookup(("measures", geometry.key), lambda: sampling.measure(mesh, ok))
            return Divided(mesh, ok, parts, measures)

        return self.store.lookup(("divided", geometry.key), make)

    def _shown(self, geometry: Geometry, mesh: Mesh, views: np.ndarray) -> list[Shown | None]:
        divided, tolerance = self._division(geometry, mesh), self.settings.tolerance
        most = most_samples(tolerance)
        slack = 1.0 if digest(mesh, self.scene.materials) else VERTEX_PIXELS
        return [show(divided, self.costs, view, self.camera, tolerance, slack, most) for view in views]

    def _by_parts(
        self, geometry: Geometry, where: np.ndarray, shown: list[Shown | None]
    ) -> tuple[list[tuple[PointSet, np.ndarray]], np.ndarray]:
        """The points of a mesh's instances `where`, by spacing, and those that have polygons. Which ranges and parts
        they draw is noted where it is not all."""
        mesh = geometry.mesh
        assert mesh is not None
        divided = self._division(geometry, mesh)
        with_polygons = []
        by_spacing: dict[float, list[int]] = {}
        for i, one in enumerate(shown):
            if one is None or one.whole:
                continue
            if one.choice.polygons.any():
                with_polygons.append(i)
                if not one.choice.polygons.all():
                    self.parts[int(where[i])] = np.flatnonzero(one.choice.polygons)
            if one.choice.points.any():
                by_spacing.setdefault(one.spacing, []).append(i)
        found = []
        for spacing, some in sorted(by_spacing.items()):
            worth = divided.worth(self.costs, spacing, most_samples(self.settings.tolerance))
            point_set, sampled = self._sampled_parts(geometry, divided, spacing, worth)
            for i in some:
                one = shown[i]
                if one is not None and len(point_set) == len(sampled.samples) and not one.choice.points[worth].all():
                    self.ranges[int(where[i])] = sampled.ranges(one.choice.points)
            found.append((point_set, np.array(some)))
        return found, where[np.array(with_polygons, int)]

    def _sampled_parts(
        self, geometry: Geometry, divided: Divided, spacing: float, worth: np.ndarray
    ) -> tuple[PointSet, PartSamples]:
        """The samples of all parts that are points in some view."""
        mesh, ok, store, table = divided.mesh, divided.ok, self.store, self.scene.materials
        look, first = digest(mesh, table), sampling.centre(mesh)
        whole = bool(worth.all())
        # Parts that lie in the mesh's own order, all of them, depend on its topology alone.
        shape = (mesh.topology or geometry.key, geometry.name)
        same = shape if whole and divided.parts.order is None else (geometry.key, worth.tobytes())
        sampled, origin = store.lookup(
            ("places by part", same, spacing), lambda: (sample_parts(divided, spacing, worth), first)
        )
        key = ("samples by part", geometry.key, same, look, spacing)

        def make() -> PointCloud:
            evaluated = sampling.evaluate(mesh, sampled.samples, origin, ok)
            return finite(point_cloud(mesh, sampled.samples, evaluated, table))[0]

        family = ("family by part", same, look, spacing)
        return PointSet(key, store.lookup(key, make), family=family), sampled

    def _points(
        self, geometry: Geometry, view_from_object: np.ndarray, all_far: bool = False
    ) -> list[tuple[PointSet, np.ndarray]] | None:
        """The points of a geometry at the density that this view needs, for all or for some of its instances; None
        where polygons are drawn. `all_far`: triangles are known to be small."""
        if geometry.cloud is not None:
            return [(self._given_points(geometry, geometry.cloud), np.arange(len(view_from_object)))]
        mesh = geometry.mesh
        if mesh is None or len(mesh.triangles) == 0:
            return []
        ok = self._valid(geometry, mesh)
        if not ok.any():
            return []
        if geometry.primitive == "POLYGONS":
            return None
        needed = self._needed(geometry, mesh, ok, view_from_object)
        if not np.isfinite(needed):
            return []
        if geometry.primitive == "AUTO":
            edge = self.store.lookup(("edge", geometry.key), lambda: _typical_edge(mesh, ok))
            if not all_far and edge * self.settings.tolerance > POLYGON_PIXELS * needed:
                return None
            if len(view_from_object) * len(mesh.triangles) <= MOST_LEAVES:
                leaves = self.store.lookup(("leafy", geometry.key), lambda: leafy(mesh.position, mesh.triangles[ok]))
                if leaves:
                    return None
        return self._dense(geometry, mesh, needed, view_from_object)

    def _all_points(self, geometry: Geometry, view_from_object: np.ndarray) -> list[tuple[PointSet, np.ndarray]]:
        """The same for a mesh that is points whatever its parts are."""
        mesh = geometry.mesh
        assert mesh is not None
        needed = self._needed(geometry, mesh, self._valid(geometry, mesh), view_from_object)
        if not np.isfinite(needed):  # boxes around parts reach into the picture, and no triangle does
            return []
        return self._dense(geometry, mesh, needed, view_from_object)

    def _dense(
        self, geometry: Geometry, mesh: Mesh, needed: float, view_from_object: np.ndarray
    ) -> list[tuple[PointSet, np.ndarray]]:
        """Points as dense as `needed`; of instances that allow it, octaves less."""
        ok = self._valid(geometry, mesh)
        if len(view_from_object) >= MANY_INSTANCES:
            needed = min(needed, self._coarsest(geometry, mesh, ok))
        octave = self._octaves(geometry, mesh, ok, needed, view_from_object)
        return [
            (self._sampled(geometry, mesh, ok, needed, int(n)), np.flatnonzero(octave == n)) for n in np.unique(octave)
        ]

    def _needed(self, geometry: Geometry, mesh: Mesh, ok: np.ndarray, view_from_object: np.ndarray) -> float:
        """The spacing that one or more instances need in this view."""
        parts = None
        if len(mesh.triangles) >= MANY_TRIANGLES:
            parts = self.store.lookup(("parts", geometry.key), lambda: make_parts(mesh, ok))
        tolerance = self.settings.tolerance
        return required_spacing(mesh, view_from_object, self.camera, tolerance, max_samples=None, ok=ok, parts=parts)

    def _near(self, geometry: Geometry, view_from_object: np.ndarray) -> np.ndarray:
        """(I,) bool: instances of a mesh, some of which is to be drawn as polygons, that are so large on the
        screen that they are, or may be."""
        mesh = geometry.mesh
        near = np.ones(len(view_from_object), bool)
        if mesh is None or geometry.primitive == "POLYGONS" or len(near) == 1 or not self.camera.perspective:
            return near
        ok, _ = self.store.lookup(("valid", geometry.key), lambda: sampling.validate(mesh))
        edge = self.store.lookup(("edge", geometry.key), lambda: _typical_edge(mesh, ok))
        middle, reach = self.store.lookup(("bounds", geometry.key), lambda: _bounds(mesh, ok))
        allowed = self._allowed_by_bounds(geometry, mesh, ok, view_from_object)
        near = edge * self.settings.tolerance > POLYGON_PIXELS * allowed
        return near & visible(view_from_object, middle, reach, self.camera)

    def _octaves(
        self, geometry: Geometry, mesh: Mesh, ok: np.ndarray, needed: float, view_from_object: np.ndarray
    ) -> np.ndarray:
        """(I,) how many octaves coarser than `needed` each instance may be sampled."""
        if geometry.spacing > 0 or not self.camera.perspective or len(view_from_object) == 1:
            return np.zeros(len(view_from_object), int)
        many = len(view_from_object) > EXACT_INSTANCES
        if not many and len(view_from_object) * len(mesh.triangles) <= EXACT_TRIANGLES:
            allowed = np.array([self._needed(geometry, mesh, ok, matrix) for matrix in view_from_object])
        else:
            allowed = self._allowed_by_bounds(geometry, mesh, ok, view_from_object)
        with np.errstate(all="ignore"):
            # Relative to the octave that `needed` is rounded to, so that the coarser ones round alike.
            coarser = np.floor(np.log2(allowed / sampling.quantise_spacing(needed)))
            # Each triangle has a sample, however coarse the spacing is.
            most = self.store.lookup(("edge", geometry.key), lambda: _typical_edge(mesh, ok))
            if len(view_from_object) >= MANY_INSTANCES:
                most = min(most, self._coarsest(geometry, mesh, ok))
            most = np.clip(np.ceil(np.log2(most / needed)), 0, COARSEST_OCTAVE)
        return np.clip(np.nan_to_num(coarser), 0, np.nan_to_num(most)).astype(int)

    def _coarsest(self, geometry: Geometry, mesh: Mesh, ok: np.ndarray) -> float:
        """The spacing beyond which instances that are many are not sampled: outlines grow by about a quarter of it, and
        hierarchies made of finer samples have coarser nodes that do not."""
        return 2 * self.store.lookup(("bounds", geometry.key), lambda: _bounds(mesh, ok))[1] / SHARED_CELLS

    def _given_points(self, geometry: Geometry, cloud: PointCloud) -> PointSet:
        points, dropped = self.store.lookup(("finite", geometry.key), lambda: given(cloud))
        if dropped:
            self.warnings.append(f"{geometry.name}: {dropped} points that are not finite were left out")
        same = ("lattice", geometry.lattice, len(points), *points.arrays()) if geometry.lattice else ()
        return PointSet(("cloud", geometry.key), points, family=same)

    def _allowed_by_bounds(
        self, geometry: Geometry, mesh: Mesh, ok: np.ndarray, view_from_object: np.ndarray
    ) -> np.ndarray:
        """(I,) a spacing that is fine enough for each instance, from the nearest point of its bounding sphere."""
        middle, reach = self.store.lookup(("bounds", geometry.key), lambda: _bounds(mesh, ok))
        scale = largest_singular_value(view_from_object[:, :3, :3])
        depth = -(view_from_object[:, 2, :3] @ middle + view_from_object[:, 2, 3]) - reach * scale
        focal = max(abs(f) for f in self.camera.pixel_from_view()[:2])
        with np.errstate(all="ignore"):
            return np.maximum(depth, self.camera.near) * self.settings.tolerance / (focal * scale)

    def _sampled(self, geometry: Geometry, mesh: Mesh, ok: np.ndarray, needed: float, octave: int) -> PointSet:
        """Samples depend on the topology alone, so that a mesh that deforms keeps them and does not shimmer."""
        store, shape = self.store, (mesh.topology or geometry.key, geometry.name)
        spacing = geometry.spacing if geometry.spacing > 0 else needed
        known = store.finest(("spacing", shape, geometry.spacing), np.inf)
        measures = store.lookup(("measures", geometry.key), lambda: sampling.measure(mesh, ok))
        if geometry.spacing <= 0 and spacing < known:
            octave_of, most = sampling.quantise_spacing(spacing), most_samples(self.settings.tolerance)
            spacing = store.lookup(
                ("limited", shape, octave_of, most),
                lambda: sampling.limit_spacing(mesh, octave_of, most, ok, measures),
            )
        spacing = store.finest(("spacing", shape, geometry.spacing), spacing) * 2.0**octave
        needed *= 2.0**octave
        look = digest(mesh, self.scene.materials)
        # Vertices do for coarser needs than samples: their disks cover the mesh whatever its edges project to.
        loose = max(spacing, needed * (1.0 if look else VERTEX_PIXELS))
        method = store.lookup(("method", shape, loose), lambda: sampling.choose(mesh, loose, ok, measures))
        spacing = 0.0 if method == "VERTICES" else spacing
        first = sampling.centre(mesh)
        samples, origin = store.lookup(
            ("places", shape, method, spacing),
            lambda: (sampling.sample(mesh, spacing or loose, method, ok, measures), first),
        )
        key = ("samples", geometry.key, look, method, spacing)
        table = self.scene.materials

        def make() -> PointCloud:
            evaluated = sampling.evaluate(mesh, samples, origin, ok)
            return finite(point_cloud(mesh, samples, evaluated, table))[0]

        return PointSet(key, store.lookup(key, make), family=("family", shape, look, method, spacing))

    def _with_hierarchy(self, points: PointSet, view_from_object: np.ndarray) -> PointSet:
        """The point-octree is built only where it can leave out most points, often enough to pay for itself."""
        plain, points, store = points, self._filled(points), self.store
        key = ("hierarchy", *points.key)
        if key not in store:
            if not self._pays(plain, view_from_object):
                return plain
            bare = len(plain.cloud) * len(view_from_object)
            if self.interactive and points.family not in store and bare <= MOST_BARE:
                store.later(key, lambda: _hierarchy(points, store))
                return plain
        return replace(points, key=key, hierarchy=store.lookup(key, lambda: _hierarchy(points, store)))

    def _filled(self, points: PointSet) -> PointSet:
        """The points with the constants of their materials as attributes, where these differ: nodes hold the means."""
        cloud, table, store = points.cloud, self.scene.materials, self.store
        material = cloud.material
        if material is None:
            return points
        rows = store.lookup(("rows", *points.key), lambda: np.unique(material))
        rows = np.minimum(rows, len(table) - 1)  # what names no row has the last one's values
        constants = {
            "color": table.base_color,
            "surface": np.stack([table.roughness, table.metallic], axis=1),
            "emission": table.emission,
        }
        differ = {
            name: values
            for name, values in constants.items()
            if getattr(cloud, name) is None and (values[rows] != values[rows[0]]).any()
        }
        if not differ:
            return points
        held = tuple((name, values[rows].tobytes()) for name, values in differ.items())
        key = ("filled", *points.key, held)
        made = store.lookup(
            key,
            lambda: replace(cloud, **{n: v.take(material, axis=0, mode="clip") for n, v in differ.items()}),
        )
        return replace(points, key=key, cloud=made, family=(*points.family, held) if points.family else ())

    def _layer(
        self, point_sets: dict[int, PointSet], set_of_instance: np.ndarray, view_from_object: np.ndarray, wanted: str
    ) -> Layer:
        """Some point sets and their cut. Where instances of one are many, they share cuts, which are sets of their own;
        those out of view are left out, and the matrices of those that stand for others are enlarged in place. `wanted`:
        see core.cut.select."""
        tolerance, camera = self.settings.tolerance, self.camera
        sets, shared = dict(point_sets), []
        own = set_of_instance.copy()
        for instance, (first, count) in self.ranges.items():
            row = int(own[instance])
            if row >= 0 and sets[row].hierarchy is None:
                own[instance] = -1
                at = np.full(len(first), instance, np.int32)
                shared.append(Cut(at, first, count, points=int(count.sum())))
        for key, points in point_sets.items():
            where = np.flatnonzero(set_of_instance == key)
            if len(where) < MANY_INSTANCES or self.focus:
                continue
            views, levels = view_from_object[where], self._levels(points)
            if levels is None:
                middle, far, radius = _extent(points, self.store)
                gone = where[~visible(views, middle, far + radius, camera)]
                set_of_instance[gone] = own[gone] = -1
                continue
            choice = choose(levels, views, where, camera, tolerance, band=staggered(tolerance))
            own[where[choice.level != OWN]] = -1
            set_of_instance[where[choice.level == NONE]] = -1
            every = where[choice.level == ALL]
            shared.append(fully(np.array([len(points.cloud)]), np.zeros(len(every), int)).of(every))
            some = np.flatnonzero(choice.level >= 0)
            if len(some):
                at = len(self.scene.geometries) + max(sets) + 1
                sets[at] = PointSet(("levels", *points.key), levels.drawn)
                set_of_instance[where[some]] = at
                view_from_object[where[some]] = enlarged(views[some], levels.center, choice.scale[some])
                shared.append(cut_of(levels, where[some], choice.level[some]))
            if not (set_of_instance == key).any():
                del sets[key]
        rest = {key: points for key, points in point_sets.items() if (own == key).any()}
        return Layer(sets, set_of_instance, joined([self._cut(rest, own, view_from_object, wanted), *shared]))

    def _levels(self, points: PointSet) -> Levels | None:
        hierarchy = points.hierarchy
        if hierarchy is None:
            return None
        return self.store.lookup(("levels of", *points.key), lambda: make_levels(hierarchy))

    def _cut(
        self, point_sets: dict[int, PointSet], set_of_instance: np.ndarray, view_from_object: np.ndarray, wanted: str
    ) -> Cut:
        if not any(points.hierarchy for points in point_sets.values()):
            return fully(_counts(point_sets), set_of_instance)
        key = ("forest", *((row, points.key) for row, points in point_sets.items()))
        trees: Forest = self.store.lookup(
            key, lambda: forest({row: p.hierarchy or p.cloud for row, p in point_sets.items()})
        )
        scene = self.scene
        cull = np.array([bool(scene.materials.cull[_rows(g)].all()) for g in scene.geometries], bool)
        # What turns its back to the middle of the lens may face its rim.
        cull = cull[scene.instances.geometry] & (not sampled(self.camera, self.settings))
        tolerance = self.settings.tolerance
        band = staggered(tolerance)
        blur = self.focus.blur if self.focus else None
        return select(
            trees, set_of_instance, view_from_object, self.camera, tolerance, cull, band=band, blur=blur, wanted=wanted
        )

    def _wide(self, points: PointSet, view_from_object: np.ndarray) -> np.ndarray:
        """(I,) bool: instances whose typical splat is a ball that is wide on the screen."""
        if points.cloud.normal is not None or points.cloud.radii is None:
            return np.zeros(len(view_from_object), bool)
        return self._diameter(points, view_from_object) > 2 * WIDE_BALL

    def _diameter(self, points: PointSet, view_from_object: np.ndarray) -> np.ndarray:
        """(I,) pixels that the typical splat of each instance spans in the middle of it."""
        cloud, store, camera = points.cloud, self.store, self.camera
        radius = store.lookup(("radius", *points.key), lambda: _typical_radius(cloud))
        middle, _, _ = _extent(points, store)
        linear = view_from_object[:, :3, :3]
        depth = np.maximum(-(linear @ middle + view_from_object[:, :3, 3])[:, 2], camera.near)
        scale = np.abs(np.linalg.det(linear)) ** (1 / 3) * abs(camera.pixel_from_view()[0])
        return 2 * radius * scale / (depth if camera.perspective else 1.0)

    def _pays(self, points: PointSet, view_from_object: np.ndarray) -> bool:
        """Whether enough instances show this set's splats so small that a cut leaves most of them out."""
        blended = self.settings.technique in ("EWA", "PAINTER")
        limit = SMALL_SPLAT if len(view_from_object) < MANY_INSTANCES and not blended else SMALL_SHARED
        small = np.count_nonzero(self._diameter(points, view_from_object) < limit * self.settings.tolerance)
        drawn = small * self.samples * (BLENDED if blended else 1)
        return bool(small > 0) if self.interactive else bool(drawn >= HIERARCHY_PAYS)


def triangles_of(mesh: Mesh, parts: np.ndarray | None) -> int:
    """Triangles in parts (P,) of a mesh; None: of all of it."""
    count = len(mesh.triangles)
    return count if parts is None else int(np.minimum(PART, count - PART * parts).sum())


def most_samples(tolerance: float) -> int:
    """Samples that one mesh may have: a finer tolerance asks for more, up to what memory holds."""
    return int(min(sampling.MAX_SAMPLES / min(tolerance, 1.0) ** 2, sampling.MOST_SAMPLES))


def lets_through(geometry: Geometry, table: MaterialTable) -> bool:
    """Whether light passes through a geometry, all of which is alike."""
    if geometry.cloud is not None:
        return geometry.cloud.opacity is not None or geometry.cloud.extinction is not None
    return geometry.mesh is not None and passing(geometry.mesh, table) is not None


def given(cloud: PointCloud) -> tuple[PointCloud, int]:
    """What is finite of a cloud, in coherent order, and how many points were dropped."""
    cloud, dropped = finite(cloud)
    cloud = coherent(cloud)
    strewn = apart(cloud)
    return cloud if strewn is None else replace(cloud, apart=strewn), dropped


def _hierarchy(points: PointSet, store: Store) -> Hierarchy:
    """The octree that another pose or colouring of the same points has, refitted; else a new one."""
    if not points.family:
        return store.build(points.cloud)
    known, source = store.lookup(points.family, lambda: (store.build(points.cloud), points.cloud))
    if source is points.cloud:
        return known
    if len(source) != len(points.cloud):
        return store.build(points.cloud)
    return (recolor if points.family[0] == "lattice" else refit)(known, points.cloud)


def _bounds(mesh: Mesh, ok: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre and radius of a ball that holds the valid triangles."""
    used = mesh.position[np.unique(mesh.triangles[ok])].astype(np.float64)
    middle = (used.min(axis=0) + used.max(axis=0)) / 2
    return middle, float(np.sqrt(((used - middle) ** 2).sum(axis=1).max()))


def _typical_edge(mesh: Mesh, ok: np.ndarray) -> float:
    """The side of the square of the mean triangle's area."""
    a, b, c = mesh.position[mesh.triangles[ok]].astype(np.float64).transpose(1, 0, 2)
    return float(np.sqrt(np.linalg.norm(np.cross(b - a, c - a), axis=1).mean()))


def _extent(points: PointSet, store: Store) -> tuple[np.ndarray, float, float]:
    """Centre in object space, greatest distance of a point from it, greatest radius of a splat."""
    cloud = points.cloud

    def look() -> tuple[np.ndarray, float, float]:
        low, high = sampling.bounding_box(cloud.position)
        middle, squared = (low + high) / 2, []
        side = max(float((high - low).max()), np.finfo(np.float32).tiny)  # squares of 1e30 are no float32

        def measure(block: slice) -> None:
            offset = (cloud.position[block].T - middle.astype(np.float32)[:, None]) * np.float32(1 / side)
            squared.append(float(dot(offset, offset).max()))

        each_block(len(cloud), measure)
        radius = 0.0 if cloud.radii is None else float(cloud.radii[:, 0].max(initial=0.0))
        # Rounding of the middle and of float32 sums is far below a millionth of what is measured.
        reach = side * np.sqrt(max(squared)) + 2.0**-23 * np.abs(middle).max()
        return cloud.origin + middle, float(reach) * (1 + 1e-6), radius

    return store.lookup(("extent", *points.key), look)


def set_ball(points: PointSet, store: Store = STORE) -> tuple[np.ndarray, float, float]:
    """Centre (3,) in object space, greatest distance of a point of the set from it, greatest radius of a splat."""
    return _extent(points, store)


def mesh_ball(mesh: Mesh, ok: np.ndarray, store: Store = STORE) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius in object space of a ball that holds the triangles `ok` (T,) of a mesh."""
    if not ok.any():
        return np.zeros(3), 0.0
    return store.lookup(("bounds", mesh.key), lambda: _bounds(mesh, ok))


def _typical_radius(cloud: PointCloud) -> float:
    if cloud.radii is None or len(cloud) == 0:
        return 0.0
    step = max(1, len(cloud) // 4096)
    return float(np.median(cloud.radii[::step, 0]))


def _counts(point_sets: dict[int, PointSet]) -> np.ndarray:
    """(K + 1,) int64: points of each set by its key; the last one, that -1 reads, has none."""
    counts = np.zeros(max(point_sets, default=-1) + 2, np.int64)
    for key, points in point_sets.items():
        counts[key] = len(points.cloud)
    return counts


def _rows(geometry: Geometry) -> list[int]:
    if geometry.mesh is not None:
        return list(geometry.mesh.materials)
    material = geometry.cloud.material if geometry.cloud is not None else None
    return [0] if material is None else np.unique(material).tolist()


def _largest(
    set_of_instance: np.ndarray,
    point_sets: dict[int, PointSet],
    view_from_object: np.ndarray,
    camera: Camera,
    store: Store,
) -> float:
    """No visible point is wider than this radius in pixels: each instance's largest one at its nearest depth. Instances
    out of view do not count: those beside the eye would ask for a pyramid that closes gaps between bodies."""
    largest = 0.0
    focal = max(abs(f) for f in camera.pixel_from_view()[:2])
    for row, points in point_sets.items():
        matrix = view_from_object[set_of_instance == row]
        middle, reach, radius = _extent(points, store)
        matrix = matrix[visible(matrix, middle, reach + radius, camera)]
        scale = largest_singular_value(matrix[:, :3, :3])
        depth = 1.0
        if camera.perspective:
            depth = np.maximum(
                -(matrix[:, 2, :3] @ middle + matrix[:, 2, 3]) - reach * scale, max(camera.near, NEAREST)
            )
        largest = max(largest, float((radius * scale * focal / depth).max(initial=0.0)))
    return largest
