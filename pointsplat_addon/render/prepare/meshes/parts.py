"""Parts of a mesh that may each be points or triangles, and the samples of such parts."""

from __future__ import annotations

from dataclasses import field
from functools import cached_property

import numpy as np

from ....core.lod.cost import Costs, mask_runs
from ....core.numeric.record import record
from ....core.scene.mesh import Mesh
from ....core.surface.area_sampling import estimate_by_part
from ....core.surface.density import PART, Parts
from ....core.surface.samples import Samples, take_samples, vertex_of_sample
from ....core.surface.sampling import choose_method, sample_mesh
from ....core.surface.spacing import quantise_spacing
from ....core.surface.triangles import Measures, measures_of_some


@record
class DividedMesh:
    """The parts of a mesh, with the area and sample counts of each that decide between points and triangles."""

    mesh: Mesh
    parts: Parts
    measures: Measures
    _samples: dict[float, np.ndarray] = field(default_factory=dict)

    @cached_property
    def part_of_triangle(self) -> np.ndarray:
        """The index (M,) of the part that each valid triangle belongs to."""
        return self.parts.number()

    @cached_property
    def part_area(self) -> np.ndarray:
        """The area (B,) of each part, in object units squared."""
        return np.bincount(self.part_of_triangle, 0.5 * self.measures.base * self.measures.height, len(self.parts))

    @property
    def coarsest(self) -> float:
        """The coarsest octave of spacing, in object units: a coarser one would not need fewer samples."""
        return quantise_spacing(2 * self.measures.longest)

    @property
    def nbytes(self) -> int:
        return self.parts.nbytes + self.measures.nbytes + 4 * len(self.parts.triangles)

    def samples(self, spacing: float) -> np.ndarray:
        """Returns (B,) float64: about how many samples each part has at `spacing`, in object units."""
        if spacing not in self._samples:
            m = self.measures
            if choose_method(self.mesh, spacing, measures=m) == "VERTICES":
                found = self.parts.counts * (m.vertices / len(m.triangle))
            else:
                found = estimate_by_part(m, spacing, self.part_of_triangle, len(self.parts))
            self._samples[spacing] = found
        return self._samples[spacing]

    def samples_of_whole_mesh(self, needed: float, slack: float) -> float:
        """Returns about how many samples the whole mesh has if it is points at the spacing `needed`, in object units.

        The samples are its vertices if these are at most `slack` times as far apart; else those at the octave.
        """
        m = self.measures
        if choose_method(self.mesh, max(slack * needed, self.octave(needed)), measures=m) == "VERTICES":
            return float(m.vertices)
        return float(self.samples(self.octave(needed)).sum())

    @cached_property
    def fewest_samples_by_part(self) -> np.ndarray:
        """About how many samples each part has, (B,) float64, if they are the fewest that cover the mesh."""
        return self.parts.counts * min(self.measures.vertices / len(self.measures.triangle), 1.0)

    def octave(self, spacing: float) -> float:
        """Returns `spacing` rounded to an octave, and at most `coarsest`, in object units."""
        return min(quantise_spacing(spacing), self.coarsest)

    def worth_sampling(self, costs: Costs, spacing: float, most: int) -> np.ndarray:
        """Returns (B,) bool: which parts may be cheaper as points at `spacing` than as triangles, in some view.

        No part is, if their samples together would exceed `most`.
        """
        samples, covered = self.samples(spacing), 0.5 * self.part_area / spacing**2
        found = samples * (costs.point + costs.prepared) < self.parts.counts * costs.triangle + covered * costs.fragment
        return found if samples[found].sum() <= most else np.zeros_like(found)


@record
class PartSamples:
    """Samples of some parts of a mesh, sorted by part."""

    samples: Samples
    start: np.ndarray  # (B + 1,) int64: where each part's samples begin
    # Vertices on a border belong to one part but are needed to close its neighbours: (E,) sample, its part, neighbour.
    border: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    @property
    def nbytes(self) -> int:
        return self.samples.nbytes + self.start.nbytes + sum(a.nbytes for a in self.border or ())

    def ranges(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns first index and count, (R,) int64, of runs of samples that cover the parts `points`, (B,) bool."""
        shown = np.repeat(points, np.diff(self.start))
        if self.border is not None and not points.all():
            sample, owner, neighbour = self.border
            shown[sample[points[neighbour] & ~points[owner]]] = True
        return mask_runs(shown)


def sample_parts(divided: DividedMesh, spacing: float, which: np.ndarray) -> PartSamples:
    """Samples the parts `which`, (B,) bool, of a mesh at `spacing`, in object units."""
    mesh, number = divided.mesh, divided.part_of_triangle
    mine = which[number]
    m = divided.measures if mine.all() else measures_of_some(divided.measures, mine)
    method = choose_method(mesh, spacing, mine, m)
    samples = sample_mesh(mesh, spacing, method, mine, m)
    part = number[samples.triangle]
    if (np.diff(part) < 0).any():
        order = np.argsort(part, kind="stable")
        samples, part = take_samples(samples, order), part[order]
    start = np.searchsorted(part, np.arange(len(divided.parts) + 1))
    border = _border_samples(mesh, samples, part, number, mine) if method == "VERTICES" else None
    return PartSamples(samples, start, border)


def _border_samples(
    mesh: Mesh, samples: Samples, part: np.ndarray, of_triangle: np.ndarray, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the vertex samples on borders between parts as PartSamples.border has them.

    `part`: (N,) of each sample. `of_triangle`: (T,) the part of each triangle. `inside`: (T,) bool, sampled triangles.
    """
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


def count_triangles(mesh: Mesh, parts: np.ndarray | None) -> int:
    """Returns the number of triangles in `parts`, (P,) int, of a mesh; None: in all of it."""
    count = len(mesh.triangles)
    return count if parts is None else int(np.minimum(PART, count - PART * parts).sum())
