"""What scripts/error_vs_time/measure.py measured: errors of pictures, Pareto fronts, exponents, tables and plots.

A row is a dict of one picture: scene, program, technique, tolerance (pixels), samples, shadow_resolution, dof_method,
series (which sweep it belongs to), rmse (scene-linear), psnr (decibels, sRGB), flip (0..1, or None), to_cycles (the
RMSE against what Cycles comes to; absent where Cycles does not draw the scene), seconds (of the processor in all
threads), prepare and passes (of these, PointSplat alone), points, bytes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from scripts.benchmarks.beside_cycles.figures import rmse
from scripts.common.images import displayed, psnr

Row = dict[str, Any]
LEVELS = (0.05, 0.03, 0.02, 0.01, 0.005, 0.003, 0.002)  # RMSE that the table asks for
LONGEST = 3  # passes of a picture that the table names
COLORS = {
    "VISIBILITY": "tab:cyan",
    "IMAGE_SPACE": "tab:blue",
    "EWA": "tab:green",
    "PAINTER": "tab:orange",
    "AUTO": "black",
    "Cycles": "tab:red",
    "EEVEE": "tab:purple",
    "VTK": "tab:brown",
}
MARKS = {"tolerance": "o", "shadows": "s", "defaults": "D", "lens": "^", "other": "x", "count": "."}
SERIES = {"lens": ", samples through the lens", "shadows": ", other shadow resolutions"}  # said in the legend
BRIEF = "Spot", "maple, shadows", "balls, depth of field", "smoke, shadows"  # scenes of the plot that is seen first
BEGIN, END = "<!-- figures -->\n", "<!-- end of figures -->\n"


# ---------------------------------------------------------------------------- figures


@dataclass(frozen=True)
class Truths:
    """What pictures of one scene are compared with, scene-linear (H, W, 3 or 4): its own truth, and two pictures of
    Cycles with many samples and different random numbers, None where Cycles does not draw the scene."""

    own: np.ndarray
    cycles: tuple[np.ndarray, np.ndarray] | None = None


def errors(found: np.ndarray, truths: Truths) -> Row:
    """Of pictures (H, W, 3 or 4), scene-linear and premultiplied: RMSE of their linear colours; PSNR in decibels and
    the mean of FLIP (Andersson et al. 2020, at 67 pixels a degree) of what a display shows. FLIP is None where
    flip-evaluator is not installed."""
    a, b = np.asarray(found, float)[..., :3], np.asarray(truths.own, float)[..., :3]
    flip = None
    if find_spec("flip_evaluator"):
        import flip_evaluator

        right, seen = (np.ascontiguousarray(displayed(picture), np.float32) for picture in (b, a))
        flip = float(flip_evaluator.evaluate(right, seen, "LDR", applyMagma=False)[1])
    everywhere = np.ones(a.shape[:2], bool)
    row = {"rmse": math.sqrt(((a - b) ** 2).mean()), "psnr": psnr(a, b, everywhere), "flip": flip}
    if truths.cycles is not None:
        row["to_cycles"] = rmse(a, *(picture[..., :3] for picture in truths.cycles))
    return row


def pareto(seconds: np.ndarray, error: np.ndarray) -> np.ndarray:
    """(N,) bool: those than which no other is both at least as fast and at least as right. Of equals the first; never
    one whose error is not a number."""
    error = np.where(np.isnan(error), np.inf, error)
    order = np.lexsort((error, seconds))
    least = np.minimum.accumulate(np.append(np.inf, error[order]))[:-1]
    front = np.zeros(len(order), bool)
    front[order] = error[order] < least
    return front


def exponent(count: np.ndarray, cost: np.ndarray) -> float:
    """e of cost ~ count^e, by least squares of the logarithms."""
    return float(np.polyfit(np.log(count), np.log(cost), 1)[0])


def fastest(rows: Iterable[Row], level: float, error: str = "rmse") -> Row | None:
    """The row that takes least time of those whose error of that name is at most `level`."""
    return min((row for row in rows if row[error] <= level), key=lambda row: row["seconds"], default=None)


def with_error(rows: Iterable[Row], error: str) -> list[Row]:
    """The pictures whose error of that name was measured."""
    return [row for row in rows if row["series"] != "count" and row.get(error) is not None]


def series(rows: list[Row]) -> dict[str, list[Row]]:
    """Rows by what they are named after: a technique of PointSplat's, or a program."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row["technique"] if row["program"] == "PointSplat" else row["program"], []).append(row)
    return found


# ---------------------------------------------------------------------------- tables


def said(row: Row) -> str:
    """How a picture of PointSplat's or of another program was made, briefly."""
    parts = [f"{row['samples']} samples" if row["samples"] > 1 else "1 sample"]
    if row["program"] == "PointSplat" and row["technique"] != "AUTO":
        parts.insert(0, f"{row['tolerance']:g} px")
    if row.get("dof_method"):
        parts.append(row["dof_method"])
    if row["series"] == "shadows":
        parts.append(f"shadows {row['shadow_resolution']}")
    if row["program"] == "VTK" and row["points"]:
        parts.append(f"{row['points']} points")
    return ", ".join(parts)


def markdown(header: list[str], lines: list[list[str]]) -> str:
    every = [header, ["---"] * len(header), *lines]
    return "".join(f"| {' | '.join(line)} |\n" for line in every)


def level_table(rows: list[Row], error: str) -> str:
    """Least seconds for each error of that name, by scene and by what draws."""
    lines = []
    rows = with_error(rows, error)
    for scene in dict.fromkeys(row["scene"] for row in rows):
        for name, curve in series([r for r in rows if r["scene"] == scene]).items():
            best = [fastest(curve, level, error) for level in LEVELS]
            least = min(curve, key=lambda row: row[error])
            lines.append(
                [scene, name, *(f"{b['seconds']:.2f}" if b else "" for b in best),
                 f"{least[error]:.4f} ({least['seconds']:.2f} s: {said(least)})"]
            )  # fmt: skip
    return markdown(["scene", "drawn by", *(f"{level:g}" for level in LEVELS), "least RMSE"], lines)


def front_table(rows: list[Row]) -> str:
    """The pictures on PointSplat's Pareto fronts, and those of the other programs."""
    lines = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        every = [r for r in rows if r["scene"] == scene and r["series"] != "count"]
        ours = [r for r in every if r["program"] == "PointSplat"]
        front = pareto(np.array([r["seconds"] for r in ours]), np.array([r["rmse"] for r in ours]))
        kept = [r for r, on in zip(ours, front, strict=True) if on] + [r for r in every if r["program"] != "PointSplat"]
        for r in sorted(kept, key=lambda row: (row["program"] != "PointSplat", row["program"], row["seconds"])):
            name = r["technique"] if r["program"] == "PointSplat" else r["program"]
            flip = "" if r["flip"] is None else f"{r['flip']:.4f}"
            points = f"{r['points']}" if r["points"] else ""
            size = f"{r['bytes']['gpu'] / 2**20:.1f}" if r.get("bytes") else ""
            to_cycles = f"{r['to_cycles']:.5f}" if r.get("to_cycles") is not None else ""
            lines.append([scene, name, said(r), f"{r['seconds']:.3f}", f"{r['rmse']:.5f}", f"{r['psnr']:.1f}", flip,
                          to_cycles, points, size, longest(r)])  # fmt: skip
    header = ["scene", "drawn by", "how", "seconds", "RMSE", "PSNR", "FLIP", "to Cycles", "points", "GPU MiB", "ms"]
    return markdown(header, lines)


def longest(row: Row) -> str:
    """Where the time of a picture of PointSplat's went, in milliseconds: the longest parts, and all the rest."""
    if row["prepare"] is None:
        return ""
    parts = sorted({"prepare": row["prepare"], **row["passes"]}.items(), key=lambda part: -part[1])[:LONGEST]
    rest = row["seconds"] - sum(seconds for _, seconds in parts)
    return ", ".join(f"{name} {1e3 * seconds:.0f}" for name, seconds in [*parts, ("rest", rest)])


def exponents(rows: list[Row]) -> dict[str, float]:
    """Of the time over the number of points, by what draws."""
    counted = series([row for row in rows if row["series"] == "count"])
    return {
        name: exponent(np.array([r["points"] for r in curve]), np.array([r["seconds"] for r in curve]))
        for name, curve in counted.items()
    }


def written(text: str, rows: list[Row]) -> str:
    """A page with its part between BEGIN and END replaced by tables."""
    fits = "".join(f"- {name}: {value:.2f}\n" for name, value in exponents(rows).items())
    tables = (
        f"### Seconds to an error\n\n{level_table(rows, 'rmse')}\n"
        f"### Seconds to an error against Cycles' converged pictures\n\n{level_table(rows, 'to_cycles')}\n"
        f"### Exponents of the time over the number of points\n\n{fits}\n"
        "### Pareto fronts, and the other programs\n\n"
        f"<details>\n<summary>Every picture on them</summary>\n\n{front_table(rows)}\n</details>\n\n"
    )
    head, rest = text.split(BEGIN)
    return head + BEGIN + "\n" + tables + END + rest.split(END)[1]


# ---------------------------------------------------------------------------- plots


def plot(rows: list[Row], path: Path, error: str = "rmse") -> None:
    """A panel for each scene, of the error of that name over time with PointSplat's Pareto front."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = with_error(rows, error)
    names = list(dict.fromkeys(row["scene"] for row in rows))
    panels = len(names)
    if panels == 0:
        return
    across = min(panels, 4)
    down = -(-panels // across)
    size = 3.4 * across, 3.1 * down + 0.7
    figure, axes = pyplot.subplots(down, across, figsize=size, squeeze=False, layout="constrained")
    for axis, name in zip(axes.flat, names, strict=False):
        draw_scene(axis, name, [r for r in rows if r["scene"] == name], error)
    for axis in list(axes.flat)[panels:]:
        axis.set_axis_off()
    seen = labels(axes)
    figure.legend(seen.values(), seen.keys(), loc="outside lower center", ncols=min(4, 2 * across), fontsize=10)
    figure.savefig(path, dpi=100)


def plot_brief(rows: list[Row], path: Path) -> None:
    """What matters most, for a narrow page: of a few scenes the front of PointSplat's pictures, its defaults, and the
    other programs."""
    from matplotlib import pyplot

    names = [name for name in BRIEF if any(row["scene"] == name for row in rows)]
    if not names:
        return
    with pyplot.rc_context({"font.size": 13}):
        figure, axes = pyplot.subplots(1, len(names), figsize=(3.2 * len(names), 4.0), squeeze=False,
                                       layout="constrained")  # fmt: skip
        for axis, name in zip(axes.flat, names, strict=True):
            found = [r for r in rows if r["scene"] == name and r["series"] != "count"]
            draw_front(axis, [row for row in found if row["program"] == "PointSplat"], "rmse")
            for label, curve in series([r for r in found if r["series"] in ("defaults", "other")]).items():
                draw_curve(axis, label, "defaults" if label == "AUTO" else "other", curve, "rmse")
            axis.set(title=name, xlabel="processor time (s)")
            logarithmic(axis)
        axes[0, 0].set_ylabel("RMSE, scene-linear")
        seen = labels(axes)
        figure.legend(seen.values(), seen.keys(), loc="outside lower center", ncols=4)
        figure.savefig(path, dpi=80)
        pyplot.close(figure)


def plot_counts(rows: list[Row], path: Path) -> None:
    """Cost over the number of points, with fitted exponents."""
    from matplotlib import pyplot

    counted = [row for row in rows if row["series"] == "count"]
    if not counted:
        return
    figure, axis = pyplot.subplots(figsize=(5.6, 4.2), layout="constrained")
    draw_counts(axis, counted)
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def logarithmic(axis: Any) -> None:
    """Both axes, with numbers at powers of ten, and at twice and five times these where they are few."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set(xscale="log", yscale="log")
    axis.autoscale_view()
    for side, limits in ((axis.xaxis, axis.get_xlim()), (axis.yaxis, axis.get_ylim())):
        few = math.log10(limits[1] / limits[0]) < 2
        side.set_major_locator(LogLocator(subs=(1, 2, 5) if few else (1,)))
        side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        side.set_minor_formatter(NullFormatter())
    axis.grid(alpha=0.3, which="both", linewidth=0.4)


def labels(axes: np.ndarray) -> dict[str, Any]:
    """Handles of a legend for all of some axes, by label; fitted exponents have one of their own."""
    pairs = [pair for axis in axes.flat for pair in zip(*axis.get_legend_handles_labels(), strict=True)]
    return {label: handle for handle, label in pairs if " ~ " not in label}


def draw_front(axis: Any, ours: list[Row], error: str) -> None:
    """The Pareto front of PointSplat's pictures."""
    seconds, errors = np.array([r["seconds"] for r in ours]), np.array([r[error] for r in ours])
    front = pareto(seconds, errors)
    order = np.flatnonzero(front)[np.argsort(seconds[front])]
    axis.step(seconds[order], errors[order], where="post", color="0.6", linewidth=4, alpha=0.6, zorder=1,
              label="Pareto front of PointSplat")  # fmt: skip


def draw_scene(axis: Any, title: str, rows: list[Row], error: str) -> None:
    draw_front(axis, [row for row in rows if row["program"] == "PointSplat"], error)
    for name, curve in series(rows).items():
        for kind in dict.fromkeys(row["series"] for row in curve):
            draw_curve(axis, name, kind, [row for row in curve if row["series"] == kind], error)
    axis.set(title=title, xlabel="processor time (s)", ylabel="RMSE, scene-linear")
    logarithmic(axis)


def draw_curve(axis: Any, name: str, kind: str, rows: list[Row], error: str) -> None:
    """Pictures of one series: joined over samples where all else is the same."""
    label = f"defaults ({name})" if name == "AUTO" else name + SERIES.get(kind, "")
    strong = kind in ("defaults", "other")
    lines: dict[tuple, list[Row]] = {}
    for row in rows:
        lines.setdefault((row["tolerance"], row["shadow_resolution"], row["dof_method"]), []).append(row)
    for line in lines.values():
        axis.plot([r["seconds"] for r in line], [r[error] for r in line], marker=MARKS[kind], color=COLORS[name],
                  markersize=5 if strong else 3, linewidth=1.4 if strong else 0.5, label=label,
                  fillstyle="none" if kind == "shadows" else "full", zorder=3 if strong else 2)  # fmt: skip


def draw_counts(axis: Any, rows: list[Row]) -> None:
    fits = exponents(rows)
    for name, curve in series(rows).items():
        count, seconds = (np.array([r[key] for r in curve], float) for key in ("points", "seconds"))
        axis.loglog(count, seconds, "o", markersize=4, color=COLORS[name])
        fitted = np.exp(np.log(seconds).mean()) * (count / np.exp(np.log(count).mean())) ** fits[name]
        axis.loglog(count, fitted, linewidth=1.2, color=COLORS[name], label=f"{name} ~ N^{fits[name]:.2f}")
    axis.set(title="cost over points, all drawn", xlabel="points", ylabel="processor time (s)")
    axis.grid(alpha=0.3, which="both", linewidth=0.4)
    axis.legend(fontsize=7)
