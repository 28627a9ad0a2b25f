"""Figures of scripts/benchmarks/beside_cycles: errors of pictures, medians of runs, shares of Cycles'."""

from __future__ import annotations

import math
import statistics

import numpy as np


def rmse(picture: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
    """Root mean square error against a truth that two independent estimates of it are known of.

    Their own errors are of mean 0 and independent, so that mean((x - A)(x - B)) has none of their variance.
    """
    product = (picture.astype(float) - first) * (picture.astype(float) - second)
    return float(max(product.mean(), 0.0) ** 0.5)


def errors(picture: np.ndarray, first: np.ndarray, second: np.ndarray) -> dict[str, float]:
    """Errors of colour and of alpha against two estimates (H, W, 4) of the truth; both means, and the truth's."""
    truth = (first.astype(float) + second) / 2
    return {
        "rmse": rmse(picture[..., :3], first[..., :3], second[..., :3]),
        "rmse_alpha": rmse(picture[..., 3], first[..., 3], second[..., 3]),
        "alpha": float(picture[..., 3].mean(dtype=float)),
        "true_alpha": float(truth[..., 3].mean()),
        "brightness": float(picture[..., :3].mean(dtype=float) / max(truth[..., :3].mean(), 1e-12)),
    }


def median(runs: list[dict]) -> dict:
    """The run of median time, with the medians of all figures of time and the number of runs."""
    for run_ in runs:
        if "failed" in run_:
            return run_
    ordered = sorted(runs, key=lambda run_: run_["seconds"])
    keys = ("seconds", "processor", "second", "second_processor")
    middle = {key: statistics.median(run_[key] for run_ in runs) for key in keys}
    spread = [ordered[0]["seconds"], ordered[-1]["seconds"]]
    return ordered[len(runs) // 2] | middle | {"runs": len(runs), "spread": spread}


def with_shares(rows: list[dict]) -> list[dict]:
    """The rows with what they take of Cycles' time and memory, and Cycles' time at their error."""
    cycles = [row for row in rows if row["program"] == "CYCLES" and "failed" not in row]
    for row in rows:
        if "failed" in row or not cycles:
            continue
        row["of_cycles"] = {key: row[key] / cycles[0][key] for key in ("seconds", "processor", "second", "peak")}
        if len(cycles) > 1 and "rmse" in row and row["program"] != "CYCLES":
            row["equal"] = equal_time(row["rmse"], cycles)
    return rows


def equal_time(error: float, cycles: list[dict]) -> float | None:
    """Seconds in which Cycles comes to an error, between its rows; None beyond them."""
    found = sorted((row["rmse"], row["seconds"]) for row in cycles if row["rmse"] > 0)
    if not found or not found[0][0] <= error <= found[-1][0]:
        return None
    errors, seconds = np.log(np.array(found)).T
    return float(np.exp(np.interp(math.log(error), errors, seconds)))
