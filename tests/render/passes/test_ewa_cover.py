"""EWA leaves out splats that others hide: fewer are drawn, and the picture is the same."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.passes.ewa import cover, ewa
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, solid_cases
from scripts.scenes.case import Case
from scripts.scenes.drawing import render
from scripts.scenes.store import STORE

ONLY_COMBINED = frozenset({"combined"})
COUNT = 60_000
PROGRAMS = {"sizes", "open", "needed"}


def ball(radius: float, hole: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions, normals, radii and colours of splats that lie evenly on the unit sphere, but for a hole toward -Y."""
    i = np.arange(COUNT) + 0.5
    y, turn = 1 - 2 * i / COUNT, np.pi * (1 + 5**0.5) * i
    side = np.sqrt(1 - y * y)
    normal = np.stack([side * np.cos(turn), y, side * np.sin(turn)], axis=1)
    color = np.random.default_rng(5).random((COUNT, 3))
    kept = (normal[:, 1] > 0) | (np.hypot(normal[:, 0] - 0.2, normal[:, 2]) > hole)
    return normal[kept], normal[kept], np.full(kept.sum(), radius), color[kept]


def case(key: str, *things: tuple[np.ndarray, ...]) -> Case:
    """Splats that glow, over nothing."""
    position, normal, radii, color = (np.concatenate(part).astype(np.float32) for part in zip(*things, strict=True))
    cloud = PointCloud(position, normal=normal, radii=radii[:, None], emission=color)
    table = build.materials(base_color=[[0, 0, 0]], specular=[0])
    scene = build.scene((build.points(key, cloud), build.moved()), lights=(), world=World(), table=table,
                         transparent=True)  # fmt: skip
    camera = cameras.camera((0, -4, 0), resolution=(300, 300), parallel=2.3)
    return Case(scene, camera, Settings(technique="EWA", use_shadows=False, use_adaptive_sampling=False))


def wires() -> tuple[np.ndarray, ...]:
    """Rows of fine splats in front of the ball."""
    along = np.linspace(-0.8, 0.8, 400)
    position = np.concatenate(
        [np.stack([along, np.full(400, -1.2), np.full(400, z)], axis=1) for z in (-0.31, 0.02, 0.44)]
    )
    count = len(position)
    return position, np.tile([0.0, -1.0, 0.0], (count, 1)), np.full(count, 0.006), np.tile([1.0, 0.0, 0.0], (count, 1))


@pytest.fixture
def drawn(monkeypatch):
    """Splats in the lists of the last picture, by list."""
    counts: dict[str, int] = {}
    see = ewa.Ewa.see

    def counting(self, *arguments):
        counts.clear()
        for splats in self._splats:
            counts.update({name: len(index) for name, index in splats.found.items()})
        return see(self, *arguments)

    monkeypatch.setattr(ewa.Ewa, "see", counting)
    return counts


SCENES = {  # the things; the share of all splats that is blended at most, and drawn for visibility
    "closed": ((ball(0.014),), 0.66, 0.66),  # measured 0.63, 0.63
    "with a hole": ((ball(0.014, hole=0.3),), 0.68, 0.68),  # measured 0.65, 0.65
    "wide": ((ball(0.055),), 0.71, 0.59),  # measured 0.69, 0.57; with one sample 0.42
    "wide, with a hole": ((ball(0.055, hole=0.3),), 0.74, 0.61),  # measured 0.71, 0.59
    "wide, behind wires": ((ball(0.055), wires()), 0.72, 0.6),  # measured 0.69, 0.58
}


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("name", SCENES)
def test_pictures_are_the_same_with_fewer_splats(name, samples, drawn, monkeypatch):
    things, blended, seen = SCENES[name]
    total = sum(len(part[0]) for part in things)
    thing = case(f"left out {name}", *things)
    found = picture(thing, samples)
    assert drawn["blended"] < blended * total
    assert drawn["first"] + drawn["then"] < seen * total
    monkeypatch.setattr(cover, "LEAST_SPLATS", 1 << 30)
    whole = picture(thing, samples)
    assert "blended" not in drawn
    assert drawn["first"] + drawn["then"] == total
    assert (whole[..., 3] == 1).sum() > 30_000
    assert np.abs(found - whole).max() < 1e-6  # measured 0


def picture(case: Case, samples: int) -> np.ndarray:
    return render(case, ONLY_COMBINED, samples).pixels["combined"].astype(float)


def test_what_is_full_of_holes_leaves_nothing_out(drawn):
    """Half of its splats show their backs, and are seen through it."""
    position, normal, radii, color = ball(0.014)
    kept = np.random.default_rng(6).random(COUNT) < 0.6
    picture(case("full of holes", tuple(part[kept] for part in (position, normal, radii, color))), 1)
    assert "blended" not in drawn
    assert drawn["first"] + drawn["then"] == kept.sum()


def test_thinning_leaves_no_pattern_of_the_numbers():
    """Numbers of rows and spirals: each part of them keeps its share."""
    index = np.arange(1 << 18)
    kept = np.isin(index, cover.thinned(index, 0.25))
    for period in (2, 3, 8, 64, 610, 4096):
        share = np.bincount(index % period, kept) / np.bincount(index % period)
        deviation = np.sqrt(0.25 * 0.75 / (len(index) / period))
        assert np.abs(share - 0.25).max() < 5 * deviation  # measured 3.5 deviations
    turn = (index * (np.sqrt(5) - 1) / 2) % 1
    share = np.histogram(turn[kept], 64, (0, 1))[0] / np.histogram(turn, 64, (0, 1))[0]
    assert np.abs(share - 0.25).max() < 0.035  # measured 0.017


def test_few_splats_compile_none_of_it():
    device = NullDevice()
    few = replace(solid_cases.sphere(), settings=Settings(technique="EWA", use_shadows=False))
    Renderer(device, STORE).render(few.scene, few.request(ONLY_COMBINED, 1))
    assert not PROGRAMS & {interface.name for interface in device.interfaces}
