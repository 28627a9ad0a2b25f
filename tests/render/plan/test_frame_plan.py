"""Planning a frame: what is decided before anything of it is on a device."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.lod.cost import DEFAULT
from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.null import LIMITS, NullDevice
from pointsplat_addon.render.device.clock import Cancelled, Clock
from pointsplat_addon.render.plan.frame_plan import UNLIT, FramePlan, make_frame_plan
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import indirect_cases
from scripts.scenes.case import ALL_PASSES, Case
from scripts.scenes.cases import CASES
from scripts.scenes.store import STORE

COMBINED = frozenset({"combined"})


def planned(case: Case, request: Request, clock: Clock | None = None, presented: bool = False) -> FramePlan:
    return make_frame_plan(
        case.scene, request, STORE, LIMITS, DEFAULT, clock or Clock(NullDevice()), presented, picture=True
    )


@pytest.mark.parametrize("name", ["empty", "mixed", "smoke", "strands", "environment"])
def test_planning_a_frame_puts_nothing_on_the_device(name):
    device = NullDevice()
    planned(CASES[name](), CASES[name]().request(), Clock(device))
    assert not device.textures
    assert not device.calls


@pytest.mark.parametrize("name", ["mixed", "region", "cube"])
def test_a_picture_of_the_cameras_window_lies_within_that_of_the_view(name):
    case = CASES[name]()
    found = planned(case, case.request())
    width, height = found.size
    assert found.size == case.camera.window[2:]
    inner = np.arange(1.0, 1.0 + width * height).reshape(height, width)
    outer = found.padded(inner)
    assert outer.shape == found.view.window[:1:-1]
    np.testing.assert_array_equal(found.cropped(outer), inner)
    assert outer.sum() == inner.sum()


def test_auxiliary_passes_are_drawn_by_a_camera_without_a_lens():
    case = CASES["mixed"]()
    camera = replace(case.camera, aperture=Aperture(0.2, 3.0))
    for passes, presented, samples in (
        (COMBINED, False, 0),  # no such picture
        (COMBINED, True, 1),
        (COMBINED | {"depth"}, False, 1),
        (COMBINED | {"normal"}, False, 4),
        (ALL_PASSES, False, 4),
    ):
        found = planned(case, Request(camera, case.settings, passes, 4), presented=presented)
        assert found.plan.defocus
        assert found.request.passes == COMBINED
        assert (found.auxiliary is not None) == (samples > 0)
        if found.auxiliary is not None:
            scene, request = found.auxiliary
            assert (request.camera.aperture, request.samples) == (None, samples)
            assert request.passes == passes - COMBINED
            assert not scene.lights


def test_a_cancelled_frame_is_not_planned():
    case = CASES["mixed"]()
    with pytest.raises(Cancelled):
        planned(case, case.request(), Clock(NullDevice(), cancelled=lambda: True))


def test_a_picture_that_leaves_indirect_light_out_says_so():
    """Other techniques than the visibility buffer do, and samples of a lens; without light there is none to miss."""
    case = indirect_cases.in_a_corner()
    blurred = replace(case.camera, aperture=Aperture(0.3, 1.0))

    def told(camera=blurred, scene=case.scene, **settings) -> bool:
        request = replace(case.request(COMBINED, 16), camera=camera, settings=replace(case.settings, **settings))
        found = planned(replace(case, scene=scene), request)
        warned = any(warning.startswith(UNLIT) for warning in found.warnings)
        assert not (warned and found.plan.indirect)
        return warned

    assert not told()
    assert told(dof_method="LENS_SAMPLES")
    assert told(case.camera, technique="EWA")
    assert not told(case.camera)
    assert not told(technique="EWA", use_indirect=False)
    assert not told(scene=replace(case.scene, lights=(), world=World()))
