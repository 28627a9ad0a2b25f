"""Samples through the lens against pictures of cameras that stand at its places."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.lens.thin_lens import camera_through, lens_points
from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.frame import frame
from pointsplat_addon.render.plan.lens_view import camera_of_whole_lens
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.prepare.prepare import prepare
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import drawing
from scripts.scenes.case import ALL_PASSES, Case
from scripts.scenes.cases import CASES
from scripts.scenes.store import STORE

COMBINED = frozenset({"combined"})
PENTAGON = Aperture(0.15, 4.0, 5, 0.3)
LENS = Settings(technique="IMAGE_SPACE", dof_method="LENS_SAMPLES")


def seen(case: Case, samples: int, passes: frozenset[str] = COMBINED, renderer: Renderer | None = None, **settings):
    settings = {"dof_method": "LENS_SAMPLES", "use_adaptive_sampling": False, **settings}
    request = Request(case.camera, replace(case.settings, **settings), passes, samples)
    return (renderer or drawing.opengl()).render(case.scene, request)


def with_aperture(name: str, aperture: Aperture | None = PENTAGON) -> Case:
    case = CASES[name]()
    return replace(case, camera=replace(case.camera, aperture=aperture))


@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "EWA", "PAINTER"])
@pytest.mark.parametrize("name", [
    "mixed", "region", "parallel", "environment", "far_away", "parallel_balls", "emission", "smoke", "panes", "culled",
    "many_towers", "split_mesh",
])  # fmt: skip
def test_a_picture_is_the_mean_of_those_of_cameras_at_places_on_the_lens(name, technique, monkeypatch):
    """Each of which decides anew what it draws. All of their samples are alike, for pixels have one place here."""
    monkeypatch.setattr(frame, "offsets", lambda count, filter_size: np.zeros((count, 2)))
    case = with_aperture(name)
    found = seen(case, 5, technique=technique).pixels["combined"]
    alone = [
        seen(replace(case, camera=camera_through(case.camera, point)), 5, technique=technique).pixels["combined"]
        for point in lens_points(5, PENTAGON)
    ]
    error = np.abs(found - np.mean(alone, axis=0))
    if (name, technique) == ("parallel", "PAINTER"):
        # What is painted keeps the order of the lens's middle; that of a parallel view that is turned is another.
        assert error.mean() < 5e-4  # measured 1.8e-4
        return
    assert error.max() < 1e-4  # measured 2.1e-5, of a brightness of 3
    assert np.abs(found - alone[0]).max() > 0.01  # and something is blurred


def test_one_sample_is_drawn_through_the_middle_of_the_lens():
    open_lens, pinhole = seen(with_aperture("mixed"), 1), seen(with_aperture("mixed", None), 1)
    np.testing.assert_array_equal(open_lens.pixels["combined"], pinhole.pixels["combined"])


def test_passes_that_are_not_averaged_are_those_of_the_middle():
    passes = frozenset({"depth", "position", "object_index", "material_index", "vector"})
    open_lens, pinhole = (seen(with_aperture("moving", a), 5, passes).pixels for a in (PENTAGON, None))
    for key in passes:
        np.testing.assert_array_equal(open_lens[key], pinhole[key])


def test_every_pass_of_strands_and_holdouts_is_finite():
    for name in ("strands", "holdout", "not_finite", "inside"):
        for array in seen(with_aperture(name), 5, ALL_PASSES - {"crypto_object", "crypto_material"}).pixels.values():
            assert np.isfinite(array).all()


@pytest.mark.parametrize("aperture", [
    Aperture(0.15, 1e-9), Aperture(0.15, np.inf), Aperture(1e6, 4.0), Aperture(1e-9, 4.0),
    Aperture(0.15, 4.0, 3, 9.0, 1e-4),
])  # fmt: skip
@pytest.mark.parametrize("name", ["mixed", "parallel"])
def test_extreme_lenses_have_finite_pictures(name, aperture):
    pixels = seen(with_aperture(name, aperture), 5).pixels["combined"]
    assert np.isfinite(pixels).all()


def recorded(case: Case, samples: int, **settings) -> NullDevice:
    device = NullDevice()
    seen(case, samples, COMBINED, Renderer(device, STORE), **settings)
    return device


@pytest.mark.parametrize("name", ["mixed", "smoke", "strands"])
def test_without_an_aperture_nothing_of_it_exists(name):
    """A lens without a width is none, and so is one that something else blurs."""
    plain = recorded(with_aperture(name, None), 9)
    for case, settings in (
        (with_aperture(name, replace(PENTAGON, radius=0.0)), {}),
        (with_aperture(name, None), {"dof_method": "SPLAT"}),
    ):
        other = recorded(case, 9, **settings)
        assert other.names == plain.names
        assert other.interfaces == plain.interfaces
        assert other.uploaded_bytes == plain.uploaded_bytes


@pytest.mark.parametrize("name", ["mixed", "smoke", "strands"])
def test_samples_upload_small_tables_and_compile_nothing(name):
    (_, plain), (few, many) = ([recorded(with_aperture(name, a), count) for count in (5, 9)] for a in (None, PENTAGON))
    assert set(many.interfaces) == set(plain.interfaces)
    # Lights, records of shadows, and a row of 64 KiB of instances; no page, no list, no table of shadows. Strands
    # thinner than a pixel are listed for every sample anyway.
    pinhole = 0 if name != "strands" else 49_152
    assert (many.uploaded_bytes - few.uploaded_bytes) / 4 - pinhole < 90_000  # measured 84,992


def test_tiles_whose_first_samples_agree_get_all_of_them():
    """A small bright square, blurred over many pixels, lies in few of the first samples' pictures of a tile."""
    case = with_aperture("mixed", Aperture(0.5, 2.0))
    adaptive, every = (seen(case, 32, use_adaptive_sampling=on) for on in (True, False))
    np.testing.assert_array_equal(adaptive.pixels["combined"], every.pixels["combined"])
    assert {"name": "adapt", "because": "samples through other points on the lens show what the first ones do not"} in (
        adaptive.report["skipped"]
    )


def test_what_only_the_rim_of_the_lens_sees_is_prepared():
    """A corner of a field of towers, of which more comes into view beside the middle of the lens."""
    case = with_aperture("many_towers", Aperture(1.0, 12.0))
    corner = replace(case.camera, region=(0, 0, 24, 24))
    narrow, wide = (
        prepare(case.scene, c, LENS, 4, STORE) for c in (corner, camera_of_whole_lens(case.scene, corner, STORE))
    )
    assert wide.cut.splats > narrow.cut.splats
    assert camera_of_whole_lens(case.scene, replace(corner, aperture=None), STORE).window == corner.window


def test_a_viewport_keeps_the_depths_that_the_middle_of_the_lens_sees():
    """What Blender draws over the picture is hidden by them; later samples see things elsewhere."""
    for aperture, kept in ((PENTAGON, 1), (None, 0)):
        case, device = with_aperture("mixed", aperture), NullDevice()
        settings = replace(LENS, use_adaptive_sampling=False)
        picture = Renderer(device, STORE).start(
            case.scene, Request(case.camera, settings, COMBINED, 3, interactive=True)
        )
        while picture.sample():
            pass
        picture.present()
        assert device.names.count("keep") == kept
        place, data = device.calls[-1].textures["ps_centre"], picture.targets.data_surfels
        assert data is not None
        assert (place is data.buffer.textures["centre"]) == (aperture is None)
        picture.release()
