"""scripts/error_vs_time/measure.py draws a small scene by every technique, and its figures say what they should."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("moderngl")

from scripts.benchmarks import frame
from scripts.error_vs_time import measure, truths


@pytest.fixture(scope="module")
def rows():
    return measure.quick()


def test_every_setting_has_a_row(rows):
    swept = [(r["technique"], r["tolerance"], r["samples"]) for r in rows if r["series"] == "tolerance"]
    expected = {(t, p, s) for t in measure.TECHNIQUES for p in (4.0, 1.0) for s in (1, 4)}
    assert len(swept) == len(set(swept))
    assert set(swept) == expected
    assert {r["samples"] for r in rows if r["series"] == "defaults"} == {1, 4}


def test_passes_are_part_of_the_time(rows):
    for row in rows:
        assert row["passes"]
        assert row["points"] > 0
        assert row["bytes"]["gpu"] > 0
        assert 0 < sum(row["passes"].values()) <= row["seconds"]


def test_more_samples_come_nearer_to_the_truth(rows):
    found = {(r["technique"], r["tolerance"], r["samples"]): r["rmse"] for r in rows if r["series"] == "tolerance"}
    for technique in measure.TECHNIQUES:
        for tolerance in (4.0, 1.0):
            # measured: 0.87 times as much (image space), 0.97 (EWA, which filters by itself), 0.88 (painter)
            assert found[technique, tolerance, 4] < found[technique, tolerance, 1]


def test_the_truth_is_the_sphere():
    camera = frame.camera(0.0, 48)
    few, many = (truths.sphere_truth(camera, samples) for samples in (64, 256))
    # The centre of the picture looks at (0, 0, 1), the corners past the sphere.
    pole = truths.pattern(np.array([[0.0, 0.0, 1.0]]))[0]
    assert many[24, 24] == pytest.approx(pole, abs=0.1)  # measured 0.036
    assert not many[0, 0].any()
    assert np.sqrt(((few - many) ** 2).mean()) < 0.01  # measured 0.0035


def test_the_nearest_ball_is_seen():
    """Few balls, whose picture every ray can be asked about."""
    camera, rng = frame.camera(0.3, 24), np.random.default_rng(2)
    centre, radius, color = rng.uniform(-0.8, 0.8, (200, 3)), rng.uniform(0.01, 0.2, 200), rng.random((200, 3))
    fx, fy, cx, cy = camera.pixel_from_view()
    seen = centre @ camera.view_from_world[:3, :3].T + camera.view_from_world[:3, 3]
    y, x = np.mgrid[0:24, 0:24] + 0.5
    truth = np.zeros((24, 24, 3))
    for u, v in truths.offsets(4):
        ray = np.stack([(x + u - cx) / fx, (y + v - cy) / fy, np.full(x.shape, -1.0)], axis=-1)
        along, square = ray @ seen.T, (ray**2).sum(axis=-1)[..., None]
        met = along**2 - square * ((seen**2).sum(axis=1) - radius**2)
        depth = np.where(met > 0, (along - np.sqrt(np.maximum(met, 0))) / square, np.inf)
        truth += np.where(np.isfinite(depth.min(axis=-1))[..., None], color[depth.argmin(axis=-1)], 0) / 4
    found = truths.balls_truth(camera, centre, radius, color, 4)
    assert np.mean(truth > 0) > 0.2
    assert np.abs(found - truth).max() < 1e-12  # measured 0


def test_rows_are_written_and_read(rows, tmp_path: Path):
    measure.save(rows, tmp_path / "rows.json")
    read = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))
    assert [r["samples"] for r in read] == [r["samples"] for r in rows]
    assert [r["seconds"] for r in read] == pytest.approx([r["seconds"] for r in rows], rel=1e-5)  # six digits: 5e-6
