"""Meshes that are points in some parts and triangles in others, as one view has it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...core.lod.cost import Costs, PrimitiveChoice, choose_primitives, mask_runs
from ...core.scene.bounds import mesh_centre
from ...core.scene.camera import Camera
from ...core.scene.cloud import PointCloud
from ...core.scene.materials import MaterialTable
from ...core.scene.mesh import Mesh
from ...core.scene.scene import Geometry
from ...core.surface.appearance import digest, point_cloud
from ...core.surface.area_sampling import estimate_by_part
from ...core.surface.density import PART, Parts, part_spacings
from ...core.surface.evaluation import evaluate
from ...core.surface.samples import Samples, take_samples, vertex_of_sample
from ...core.surface.sampling import choose_method, sample_mesh
from ...core.surface.spacing import quantise_spacing
from ...core.surface.triangles import Measures, measures_of_some
from ..cache.keys import Key, Kind
from .hierarchies import that_have_nodes
from .layers import MANY_INSTANCES
from .meshes import VERTEX_PIXELS, Measured, Primitives, all_points, fewest, measured, most_samples
from .parts import lets_through
from .point_sets import PointSet
from .view import View

NODES = 16.0  # of a cut, for each square of the tolerance that a curved surface holds: measured 13 to 16.5 of scans
MANY = 1 << 12  # triangles of a mesh: fewer are drawn in no time
WIDEST = (
    2.0  # typical edge of the triangles in view, over the spacing that is typically needed: splats of wider ones show
)
NODE = 2.0  # what a splat of a cut costs of one that is drawn with all others: it is found, and drawn in short blocks


@dataclass(frozen=True, eq=False)
class Divided:
    """A mesh's parts, and what the choice between points and triangles asks of each."""

    mesh: Mesh
    parts: Parts
    measures: Measures
    _samples: dict[float, np.ndarray] = field(default_factory=dict)

    @cached_property
    def number(self) -> np.ndarray:
        """(M,) the part of each valid triangle."""
        return self.parts.number()

    @cached_property
    def area(self) -> np.ndarray:
        """(B,) object units squared."""
        return np.bincount(self.number, 0.5 * self.measures.base * self.measures.height, len(self.parts))

    @property
    def coarsest(self) -> float:
        """The octave of spacing beyond which no triangle has fewer samples."""
        return quantise_spacing(2 * self.measures.longest)

    @property
    def nbytes(self) -> int:
        return self.parts.nbytes + self.measures.nbytes + 4 * len(self.parts.triangles)

    def samples(self, spacing: float) -> np.ndarray:
        """(B,) float64: about how many samples each part has."""
        if spacing not in self._samples:
            m = self.measures
            if choose_method(self.mesh, spacing, measures=m) == "VERTICES":
                found = self.parts.counts * (m.vertices / len(m.triangle))
            else:
                found = estimate_by_part(m, spacing, self.number, len(self.parts))
            self._samples[spacing] = found
        return self._samples[spacing]

    def whole(self, needed: float, slack: float) -> float:
        """About how many samples the mesh has where all of it is points that are dense enough for `needed`: vertices
        where they are at most `slack` times as far apart, else the octave of spacing."""
        m = self.measures
        if choose_method(self.mesh, max(slack * needed, self.octave(needed)), measures=m) == "VERTICES":
            return float(m.vertices)
        return float(self.samples(self.octave(needed)).sum())

    @cached_property
    def fewest(self) -> np.ndarray:
        """(B,) float64: about how many samples each part has where they are as few as cover the mesh."""
        return self.parts.counts * min(self.measures.vertices / len(self.measures.triangle), 1.0)

    def octave(self, spacing: float) -> float:
        return min(quantise_spacing(spacing), self.coarsest)

    def worth(self, costs: Costs, spacing: float, most: int) -> np.ndarray:
        """(B,) bool: parts of which some view draws points at this spacing; none where these would be more than
        `most` samples."""
        samples, covered = self.samples(spacing), 0.5 * self.area / spacing**2
        found = samples * (costs.point + costs.prepared) < self.parts.counts * costs.triangle + covered * costs.fragment
        return found if samples[found].sum() <= most else np.zeros_like(found)


@dataclass(frozen=True, eq=False)
class PartSamples:
    """Samples of some parts of a mesh, part by part."""

    samples: Samples
    start: np.ndarray  # (B + 1,) int64: where each part's samples begin
    # Vertices on a border are samples of one part, and close its neighbours too: (E,) sample, its part, the neighbour.
    border: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    @property
    def nbytes(self) -> int:
        return self.samples.nbytes + self.start.nbytes + sum(a.nbytes for a in self.border or ())

    def ranges(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and count, (R,) int64, of the samples that close the parts `points` (B,) bool."""
        shown = np.repeat(points, np.diff(self.start))
        if self.border is not None and not points.all():
            sample, owner, neighbour = self.border
            shown[sample[points[neighbour] & ~points[owner]]] = True
        return mask_runs(shown)


def sample_parts(divided: Divided, spacing: float, which: np.ndarray) -> PartSamples:
    """The samples of the parts `which` (B,) bool."""
    mesh, number = divided.mesh, divided.number
    mine = which[number]
    m = divided.measures if mine.all() else measures_of_some(divided.measures, mine)
    method = choose_method(mesh, spacing, mine, m)
    samples = sample_mesh(mesh, spacing, method, mine, m)
    part = number[samples.triangle]
    if (np.diff(part) < 0).any():
        order = np.argsort(part, kind="stable")
        samples, part = take_samples(samples, order), part[order]
    start = np.searchsorted(part, np.arange(len(divided.parts) + 1))
    border = _border(mesh, samples, part, number, mine) if method == "VERTICES" else None
    return PartSamples(samples, start, border)


def _border(
    mesh: Mesh, samples: Samples, part: np.ndarray, of_triangle: np.ndarray, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """See PartSamples.border: of vertex samples with their parts (N,), the parts of all triangles (T,)."""
    at = np.full(len(mesh.position), -1, np.int64)
    at[vertex_of_sample(mesh, samples)] = np.arange(len(samples))
    rows = np.flatnonzero(inside)
    sample = at[mesh.triangles[rows]]
    neighbour = np.broadcast_to(of_triangle[rows, None], sample.shape)
    other = part[sample] != neighbour
    count = int(of_triangle.max(initial=0)) + 1
    pairs = np.unique(sample[other] * count + neighbour[other])
    sample, neighbour = pairs // count, pairs % count
    return sample, part[sample], neighbour


@dataclass(frozen=True, eq=False)
class Shown:
    """One instance in one view: what its parts are drawn as."""

    spacing: float  # of its points
    choice: PrimitiveChoice
    whole: bool  # all of it is points, out of view or not: as dense as its nearest part needs
    nodes: bool = False  # or, where that is too many, those of an octree over as few samples as cover it

    def as_polygons(self) -> Shown:
        """The same with polygons for all that is in view."""
        c = self.choice
        every = replace(c, points=np.zeros_like(c.points), polygons=c.points | c.polygons, cost=c.triangles_cost)
        return replace(self, choice=every, whole=False, nodes=False)


def show(
    divided: Divided,
    costs: Costs,
    view_from_object: np.ndarray,
    camera: Camera,
    tolerance: float,
    slack: float,
    most: int,
    nodes: bool = False,
) -> Shown | None:
    """The cheapest way to draw an instance (4, 4); None: nothing of it is in view.

    `slack`: see Divided.whole. `most`: samples that the mesh may have. `nodes`: an octree over the fewest samples may
    be drawn as well.
    """
    needed = part_spacings(divided.parts, view_from_object, camera, tolerance)
    visible = np.isfinite(needed)
    if not visible.any():
        return None
    finest = float(needed.min())
    octaves = np.ldexp(0.5, np.frexp(needed[visible])[1])  # as quantise_spacing has it
    spacing = np.unique(np.minimum(octaves, divided.coarsest))
    worth = np.array([divided.worth(costs, s, most) for s in spacing.tolist()])
    samples = np.array([divided.samples(s) for s in spacing.tolist()])
    choice = choose_primitives(
        costs, needed, spacing, np.where(worth, samples, np.inf), divided.parts.counts, divided.area
    )
    every = divided.whole(finest, slack)
    whole = every * (costs.point + costs.prepared)
    if every <= most and whole <= choice.cost:
        choice = replace(choice, points=visible, polygons=np.zeros_like(visible), cost=whole)
        shown = Shown(divided.octave(finest), choice, whole=True)
    else:
        shown = Shown(float(spacing[choice.octave]), choice, whole=False)
    edge = np.sqrt(2 * divided.area[visible].sum() / divided.parts.counts[visible].sum())
    if nodes and len(divided.measures.triangle) >= MANY and edge <= WIDEST * np.median(needed[visible]):
        cut = np.minimum(NODES * divided.area / needed**2, divided.fewest)[visible].sum()
        if (cost := float(cut) * NODE * costs.point) < shown.choice.cost:
            choice = replace(choice, points=visible, polygons=np.zeros_like(visible), cost=cost)
            return Shown(divided.coarsest, choice, whole=True, nodes=True)
    return shown


def choose_parts(view: View, view_from_object: np.ndarray, usable: np.ndarray) -> dict[int, list[Shown | None]]:
    """Meshes that are chosen for part by part, by geometry row, with the choice of each instance that is `usable` (I,)
    bool. Where points would save less than the passes over all pixels cost that they need, all are polygons."""
    found: dict[int, list[Shown | None]] = {}
    scene, others = view.scene, False
    for row, geometry in enumerate(scene.geometries):
        views = view_from_object[usable & (scene.instances.geometry == row)]
        mesh = geometry.mesh
        if len(views) == 0 or geometry.strands is not None or (mesh is not None and len(mesh.triangles) == 0):
            continue
        of, points = _choosable(view, geometry, len(views))
        others |= points
        if of is None:
            continue
        view.check()
        found[row] = _shown(view, of, views)
    choices = [s.choice for some in found.values() for s in some if s is not None]
    pixels = _costs(view, 1).pixel * float(np.prod(view.camera.window[2:]))
    if not others and sum(c.triangles_cost - c.cost for c in choices) < pixels:
        found = {row: [None if s is None else s.as_polygons() for s in some] for row, some in found.items()}
    return found


def _choosable(view: View, geometry: Geometry, instances: int) -> tuple[Measured | None, bool]:
    """The mesh of a geometry, if it is chosen for part by part; if not, whether it has opaque points anyhow."""
    through = lets_through(geometry, view.scene.materials)
    if geometry.primitive != "AUTO" or geometry.spacing > 0 or instances >= MANY_INSTANCES:
        return None, geometry.primitive != "POLYGONS" and not through
    of = measured(view, geometry)
    if of is None or through:
        return None, geometry.mesh is None and not through
    # Leaves are polygons, which need none of the passes that points do.
    return (None if of.leaves(instances) else of), False


def _division(of: Measured) -> Divided:
    return of.store.lookup(Key(Kind.DIVIDED_MESH, of.geometry.key), lambda: Divided(of.mesh, of.parts, of.measures))


def _costs(view: View, instances: int) -> Costs:
    """Of one sample of a mesh with so many instances, which share what is done once; a viewport keeps it, too."""
    if view.interactive:
        return view.costs.again_and_again()
    return view.costs.of_picture(view.samples, instances)


def _shown(view: View, of: Measured, view_from_object: np.ndarray) -> list[Shown | None]:
    """The choice of each instance (I, 4, 4)."""
    divided, tolerance = _division(of), view.settings.tolerance
    most = most_samples(tolerance)
    slack = 1.0 if digest(of.mesh, view.scene.materials) else VERTEX_PIXELS
    costs = _costs(view, len(view_from_object))

    def every(nodes: bool) -> list[Shown | None]:
        return [show(divided, costs, matrix, view.camera, tolerance, slack, most, nodes) for matrix in view_from_object]

    if not view.coarse:
        return every(nodes=False)
    # There is less time than the settings' own tolerance takes: what has few samples left gets nodes.
    found = every(nodes=True)
    wanted = any(one is not None and one.nodes for one in found)
    return every(nodes=False) if wanted and _with_nodes(view, of) is None else found


def _with_nodes(view: View, of: Measured) -> PointSet | None:
    """The fewest samples of a mesh, once they have an octree."""
    name = Key(Kind.MESH_POINTS, of.geometry.key, digest(of.mesh, view.scene.materials))
    return that_have_nodes(view, name, lambda: fewest(view, of))


def split(view: View, of: Measured, shown: list[Shown | None], view_from_object: np.ndarray) -> Primitives:
    """Instances (I, 4, 4) as they were chosen for: points of their parts by spacing, then those that are all points."""
    divided, table = _division(of), view.scene.materials
    polygons, parts, ranges = [], {}, {}
    by_spacing: dict[float, list[int]] = {}
    for i, one in enumerate(shown):
        if one is None or one.whole:
            continue
        if one.choice.polygons.any():
            polygons.append(i)
            if not one.choice.polygons.all():
                parts[i] = np.flatnonzero(one.choice.polygons)
        if one.choice.points.any():
            by_spacing.setdefault(one.spacing, []).append(i)
    found, costs = [], _costs(view, len(view_from_object))
    for spacing, some in sorted(by_spacing.items()):
        worth = divided.worth(costs, spacing, most_samples(view.settings.tolerance))
        points, sampled = _sampled(of, divided, spacing, worth, table)
        for i in some:
            one = shown[i]
            if one is not None and len(points) == len(sampled.samples) and not one.choice.points[worth].all():
                ranges[i] = sampled.ranges(one.choice.points)
        found.append((points, np.array(some)))
    nodes = np.flatnonzero([one is not None and one.nodes for one in shown])
    if len(nodes):
        found.append((fewest(view, of), nodes))
    whole = np.flatnonzero([one is not None and one.whole and not one.nodes for one in shown])
    if len(whole):
        found += [(points, whole[some]) for points, some in all_points(view, of, view_from_object[whole])]
    return Primitives(found, np.array(polygons, int), parts, ranges)


def _sampled(
    of: Measured, divided: Divided, spacing: float, worth: np.ndarray, table: MaterialTable
) -> tuple[PointSet, PartSamples]:
    """The samples of all parts that are points in some view, `worth` (B,) bool."""
    mesh, store = of.mesh, of.store
    look, first = digest(mesh, table), mesh_centre(mesh)
    # Parts that lie in the mesh's own order, all of them, depend on its topology alone.
    same = of.shape if worth.all() and divided.parts.order is None else (of.geometry.key, worth.tobytes())
    sampled, origin = store.lookup(
        Key(Kind.SAMPLES_OF_PARTS, same, spacing=spacing), lambda: (sample_parts(divided, spacing, worth), first)
    )
    key = Key(Kind.POINTS_OF_PARTS, (of.geometry.key, same), look, spacing=spacing)

    def make() -> PointCloud:
        evaluated = evaluate(mesh, sampled.samples, origin)
        return point_cloud(mesh, sampled.samples, evaluated, table)

    family = Key(Kind.SHARED_HIERARCHY, same, look, "PARTS", spacing)
    return PointSet(key, store.lookup(key, make), family=family), sampled


def triangles_of(mesh: Mesh, parts: np.ndarray | None) -> int:
    """Triangles in parts (P,) of a mesh; None: of all of it."""
    count = len(mesh.triangles)
    return count if parts is None else int(np.minimum(PART, count - PART * parts).sum())
