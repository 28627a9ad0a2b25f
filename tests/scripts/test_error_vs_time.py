"""Errors, Pareto fronts, exponents, tables and plots of scripts/error_vs_time/measure.py."""

from pathlib import Path

import numpy as np
import pytest

from scripts.error_vs_time import curves

RNG = np.random.default_rng(4)


def row(scene: str, program: str, seconds: float, rmse: float | None, **more: object) -> curves.Row:
    plain = {"series": "tolerance" if program == "PointSplat" else "other", "technique": "EWA", "tolerance": 1.0,
             "samples": 16, "points": 10, "shadow_resolution": None, "dof_method": None, "psnr": 30.0, "flip": None,
             "prepare": 0.1, "passes": {"shade": 0.2}, "bytes": {"cpu": 0, "gpu": 1 << 20}}  # fmt: skip
    return {"scene": scene, "program": program, "seconds": seconds, "rmse": rmse, **plain, **more}


def test_the_front_is_what_no_other_beats_in_both():
    seconds, error = RNG.random((2, 60)).round(1)  # rounded, so that some are equal
    front = curves.pareto(seconds, error)
    no_worse = (seconds[:, None] <= seconds) & (error[:, None] <= error)
    better = no_worse & ((seconds[:, None] < seconds) | (error[:, None] < error))
    beaten = better.any(axis=0)
    assert not (front & beaten).any()
    places = np.stack([seconds, error], axis=1)
    kept, every = places[front], np.unique(places[~beaten], axis=0)
    assert np.array_equal(np.unique(kept, axis=0), every)  # all that are not beaten are there
    assert len(kept) == len(every)  # once


def test_errors_that_are_no_numbers_are_on_no_front():
    assert curves.pareto(np.array([1.0, 2.0, 3.0]), np.array([np.nan, 0.5, np.nan])).tolist() == [False, True, False]
    assert curves.pareto(np.zeros(0), np.zeros(0)).tolist() == []


def test_the_exponent_of_a_power_law_is_found():
    count = np.array([1e3, 1e4, 3e5])
    assert curves.exponent(count, 7 * count**0.75) == pytest.approx(0.75, abs=1e-9)  # measured 3e-16


def test_errors_are_those_of_linear_colours_and_leave_alpha_out():
    truth = RNG.random((8, 9, 3))
    truths, found = curves.Truths(truth), np.dstack([truth + 0.25, np.zeros((8, 9))])
    assert curves.errors(found, truths)["rmse"] == pytest.approx(0.25, abs=1e-12)  # measured 1e-16
    assert curves.errors(truth, truths)["rmse"] == 0
    assert curves.errors(truth, truths)["psnr"] == np.inf


def test_noise_of_cycles_is_no_error():
    """Two independent pictures tell what their mean alone would not: how far a picture is from what they tend to."""
    truth = RNG.random((200, 200, 3))
    cycles = truth + RNG.normal(0, 0.1, truth.shape), truth + RNG.normal(0, 0.1, truth.shape)
    found = curves.errors(truth + 0.02, curves.Truths(truth, cycles))["to_cycles"]
    assert found == pytest.approx(0.02, rel=0.1)  # measured 0.7 %
    assert "to_cycles" not in curves.errors(truth, curves.Truths(truth))


def test_the_fastest_picture_of_an_error_is_right_enough():
    rows = [row("a", "PointSplat", 1.0, 0.1), row("a", "PointSplat", 3.0, 0.01), row("a", "PointSplat", 2.0, 0.02)]
    assert curves.fastest(rows, 0.02) is rows[2]
    assert curves.fastest(rows, 0.001) is None


def test_tables_replace_what_stood_between_their_marks():
    rows = [row("a", "PointSplat", 1.0, 0.1), row("a", "PointSplat", 2.0, 0.2, tolerance=2.0),
            row("a", "Cycles", 3.0, 0.05, technique=None, points=None, bytes=None)]  # fmt: skip
    count = [row("counts", "VTK", n / 1e4, None, series="count", points=n, technique=None) for n in (100, 10_000)]
    once = curves.written(f"before\n{curves.BEGIN}old\n{curves.END}after\n", rows + count)
    assert once.startswith("before\n")
    assert once.endswith("after\n")
    assert "old" not in once
    assert "- VTK: 1.00\n" in once
    assert "2 px" not in once  # what is beaten is in no front
    assert curves.written(once, rows + count) == once


def test_the_longest_parts_of_a_picture_and_the_rest_are_all_of_it():
    passes = {"shade": 0.2, "pull": 0.01, "push": 0.5, "project": 0.3}
    one = row("a", "PointSplat", 1.3, 0.1, prepare=0.25, passes=passes)
    assert curves.longest(one) == "push 500, project 300, prepare 250, rest 250"
    assert curves.longest(row("a", "Cycles", 3.0, 0.05, prepare=None, passes={})) == ""


def test_a_plot_is_written_for_every_kind_of_row(tmp_path: Path):
    pytest.importorskip("matplotlib")
    rows = [row("a", "PointSplat", 1.0, 0.1), row("a", "Cycles", 3.0, 0.05, to_cycles=0.01),
            row("b", "EEVEE", 3.0, 0.05),
            row("b", "PointSplat", 1.0, 0.1, series="defaults", technique="AUTO")]  # fmt: skip
    count = [row("counts", "VTK", n / 1e4, None, series="count", points=n) for n in (100, 10_000)]
    curves.plot(rows + count, tmp_path / "plot.png")
    curves.plot(rows + count, tmp_path / "cycles.png", "to_cycles")
    curves.plot_counts(rows + count, tmp_path / "counts.png")
    named = [{**r, "scene": curves.BRIEF[0]} for r in rows]
    curves.plot_brief(named, tmp_path / "brief.png")
    for name in ("plot", "cycles", "counts", "brief"):
        assert (tmp_path / f"{name}.png").read_bytes()[:4] == b"\x89PNG"
    curves.plot(rows[2:], tmp_path / "no scene.png", "to_cycles")
    curves.plot_brief(rows, tmp_path / "no scene.png")
    assert not (tmp_path / "no scene.png").exists()
