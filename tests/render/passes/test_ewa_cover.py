"""EWA leaves out splats that others hide: fewer are drawn, and the picture is the same."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.passes.ewa import cover, ewa
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import solid_cases
from scripts.scenes.case import Case
from scripts.scenes.drawing import render
from scripts.scenes.store import STORE
from tests.support.hidden_splats import COUNT, SCENES, ball, case

ONLY_COMBINED = frozenset({"combined"})
PROGRAMS = {"sizes", "open", "needed"}


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
    kept = np.isin(index, cover.hashed_share(index, 0.25))
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
