"""Pictures that end before they are done, at any moment: not wanted any more, or refused by the device.

What they had on the device is given back, and the next picture is as ever.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import count

import pytest

from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.devices.null import NullDevice, NullTarget, NullTexture, NullTimer
from pointsplat_addon.render.device.clock import MOST_OPEN
from pointsplat_addon.render.device.protocol import DeviceError, Texels, Texture
from pointsplat_addon.render.frame.report import report
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes.cameras import camera
from scripts.scenes.case import ALL_PASSES, Case
from scripts.scenes.store import STORE
from scripts.scenes.translucent_cases import panes_of_functions
from tests.support.extremes import COMBINED, FEW, SHADOWED, TECHNIQUES, all_kinds

SAMPLES = 6  # so many that tiles are asked whether they need more


class CountingTimer(NullTimer):
    def __init__(self, open: set[CountingTimer]):
        self._open = open
        open.add(self)

    def milliseconds(self) -> float:
        self._open.discard(self)
        return 0.0

    def release(self) -> None:
        self._open.discard(self)


class Failing(NullDevice):
    """Refuses one texture, and all after it, as a device does whose memory is full."""

    def __init__(self, after: float = math.inf):
        super().__init__()
        self.left, self.timers = after, set[CountingTimer]()
        self.asked: list[tuple] = []

    def texture(self, size: tuple[int, int], format: str, data: Texels | None = None) -> NullTexture:
        self._take(size, format, data is None)
        return super().texture(size, format, data)

    def target(self, colors: Sequence[Texture], depth: bool = False) -> NullTarget:
        self._take(*(color.format for color in colors), depth)
        return super().target(colors, depth)

    def start_timer(self) -> CountingTimer:
        return CountingTimer(self.timers)

    def _take(self, *kind) -> None:
        self.asked.append(kind)
        self.left -= 1
        if self.left < 0:
            raise DeviceError("no memory is left")


def requests() -> dict[str, tuple[Case, Request]]:
    """Of all that is drawn: by each technique, and out of focus by splats and by samples of the lens. And of panes,
    which are triangles where nothing else is translucent."""
    case = all_kinds("cut short")
    eye = camera((0.5, -4, 0.7), resolution=FEW)
    blurred = replace(eye, aperture=Aperture(0.3, 4.0))
    found = {name.lower(): (eye, replace(SHADOWED, technique=name)) for name in TECHNIQUES}
    found |= {method.lower(): (blurred, replace(SHADOWED, dof_method=method)) for method in ("SPLAT", "LENS_SAMPLES")}
    made = {
        name: (replace(case, camera=view), Request(view, settings, ALL_PASSES, SAMPLES))
        for name, (view, settings) in found.items()
    }
    view, settings = found["visibility"]
    panes = replace(panes_of_functions(), camera=view)
    return made | {"panes": (panes, Request(view, settings, ALL_PASSES, SAMPLES))}


REQUESTS = requests()


def assert_nothing_is_left(renderer: Renderer, device: Failing) -> None:
    """But what is kept for the next picture, which goes with the renderer."""
    renderer.release()
    assert device.bytes_allocated() == 0
    assert not device.alive
    assert not device.timers


def cut_after(name: str, checks: int) -> tuple[bool, Failing]:
    """A picture that says at each check but the first so many that it is not wanted any more: whether it was finished
    all the same, and the device, on which nothing is left."""
    case, request = REQUESTS[name]
    device, asked = Failing(), count()
    renderer = Renderer(device, STORE)
    result = renderer.render(case.scene, request, cancelled=lambda: next(asked) >= checks)
    assert_nothing_is_left(renderer, device)
    assert result.cancelled == (next(asked) > checks)
    return not result.cancelled, device


# A device that only records shows panes in as many layers as there may be, before each of which it is asked.
SLOW = {"panes"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.long) if n in SLOW else n for n in REQUESTS])
def test_a_picture_that_is_not_wanted_any_more_leaves_nothing(name):
    """At each of the moments when it is asked: while points are prepared and shadows cast, and from pass to pass."""
    for checks in count():
        STORE.clear()
        if cut_after(name, checks)[1].calls:
            break
    preparing = checks
    while not cut_after(name, checks)[0]:
        checks += 1
    assert preparing > 2, preparing
    assert checks > 10


@pytest.mark.parametrize("step", [64, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.long) if n in SLOW else n for n in REQUESTS])
def test_a_device_whose_memory_is_full_keeps_nothing_of_a_picture(name, step):
    """The first texture and target of each size and format, and each `step`-th of all, is in turn the first that it
    refuses; with room again, it draws."""
    case, request = REQUESTS[name]
    whole = Failing()
    Renderer(whole, STORE).render(case.scene, request)
    first = {whole.asked.index(kind) for kind in whole.asked}
    assert len(first) > 20
    for number in sorted(first | set(range(0, len(whole.asked), step))):
        device = Failing(number)
        renderer = Renderer(device, STORE)
        with pytest.raises(DeviceError, match="no memory"):
            renderer.render(case.scene, request)
        if number % 16 == 0:
            device.left = math.inf
            assert renderer.render(case.scene, request).report["passes"]
        assert_nothing_is_left(renderer, device)


@pytest.mark.parametrize("name", REQUESTS)
def test_a_viewport_that_moves_on_after_any_sample_leaves_nothing(name):
    case, request = REQUESTS[name]
    device = Failing()
    renderer = Renderer(device, STORE)
    for samples in range(SAMPLES + 1):
        frame = renderer.start(case.scene, replace(request, passes=COMBINED, interactive=True))
        for _ in range(samples):
            frame.sample()
        frame.release()
        assert not device.timers
    assert_nothing_is_left(renderer, device)


def test_a_viewport_that_stands_still_holds_few_timers():
    """Nobody reads them until it is done, which with a budget of error may be never."""
    case, request = REQUESTS["image_space"]
    device = Failing()
    many = replace(request, passes=COMBINED, samples=400, settings=replace(SHADOWED, use_adaptive_sampling=False))
    frame = Renderer(device, STORE).start(case.scene, many)
    while frame.sample():
        assert len(device.timers) <= MOST_OPEN
    assert report(frame, 0.0)["passes"]
    frame.release()
    assert not device.timers
