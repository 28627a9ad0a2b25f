"""Several pictures in the making on one device, as of two viewports: each is as if it were alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.cache import device_cache
from pointsplat_addon.render.frame.frame import Frame
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import drawing
from scripts.scenes.cameras import camera
from scripts.scenes.store import STORE
from tests.support.extremes import COMBINED, FEW, SHADOWED, TECHNIQUES, all_kinds

SAMPLES = 8  # so many that what lies in smoke is lit anew between them, by another part of each lamp
LOOKS = {name: (None, {"technique": name}) for name in TECHNIQUES}
LOOKS |= {method: (Aperture(0.3, 4.0), {"dof_method": method}) for method in ("SPLAT", "LENS_SAMPLES")}
PAIRS = list(zip(LOOKS, [*list(LOOKS)[1:], "IMAGE_SPACE"], strict=True))


def begun(renderer: Renderer, look: str, place: float, key: str) -> Frame:
    """A viewport's picture, from an eye at `place`."""
    aperture, changes = LOOKS[look]
    eye = replace(camera((place, -4, 0.7), resolution=FEW), aperture=aperture)
    settings = replace(SHADOWED, use_adaptive_sampling=False, **changes)
    return renderer.start(all_kinds(key).scene, Request(eye, settings, COMBINED, SAMPLES))


def drawn(*frames: Frame) -> list[np.ndarray]:
    """Their means, after samples in turns."""
    for _ in range(SAMPLES):
        for frame in frames:
            frame.sample()
    found = [frame.mean() for frame in frames]
    for frame in frames:
        frame.release()
    return found


@pytest.mark.parametrize("limit", [device_cache.MOST_BYTES, 1])
@pytest.mark.parametrize(("look", "other"), PAIRS)
def test_neither_reads_what_the_other_released(look, other, limit):
    """Where there is room for both, and where there is for none: what one uses stays. The null device refuses calls
    with anything that is released."""
    renderer = Renderer(NullDevice(), STORE)
    renderer.kept.limit = limit
    for key in ("together", "elsewhere"):
        frames = begun(renderer, look, -1, "together"), begun(renderer, other, 1, key)
        drawn(*frames)
    assert len(renderer.kept._items) > 0
    drawn(begun(renderer, "IMAGE_SPACE", 0, "alone"))
    if limit == 1:
        # Pages of what is drawn no more have gone.
        assert not [key for key in renderer.kept._items if "elsewhere" in str(key)]
    renderer.release()
    assert renderer.device.bytes_allocated() == 0


@pytest.mark.parametrize(("look", "other"), PAIRS)
def test_pictures_drawn_in_turns_are_those_drawn_alone(look, other):
    renderer, views = drawing.opengl(), ((look, -1), (other, 1))
    for _ in range(2):  # the first time meshes are sampled as each view needs, from then on as both do
        alone = [drawn(begun(renderer, name, place, "in turns"))[0] for name, place in views]
    together = drawn(begun(renderer, look, -1, "in turns"), begun(renderer, other, 1, "in turns"))
    for one, two in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, two)
