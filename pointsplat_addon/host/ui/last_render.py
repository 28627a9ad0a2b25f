"""The report of the last final render, and how its panel and the image's metadata show it."""

from __future__ import annotations

from typing import Any

from .labels import TECHNIQUE_ITEMS

REPORT: dict[str, Any] = {}  # of the last final render; empty before the first
MOST_BARS = 8  # of passes, the longest ones
REST = "all else"  # time outside of passes: choosing and sampling points, comparing cuts


def lines(report: dict[str, Any]) -> list[tuple[str, str]]:
    """Pairs (label, value) that sum up a report, for people; none of an empty report."""
    if "technique" not in report:
        return []
    points = report["points"]
    found = [
        ("Time", f"{report['seconds']:.3f} s"),
        ("Points", f"{points['cut']:,} of {points['total']:,}"),
        ("Samples", f"{report['samples']} of each pixel"),
        ("Technique", f"{TECHNIQUE_ITEMS[report['technique']['name']][1]}: {report['technique']['because']}"),
    ]
    if "estimate" in report:
        found.append(("Estimated Error", error(report["estimate"])))
    return found


def error(estimate: dict[str, float | None]) -> str:
    """The root mean square error of a report's estimate, as text; says so if one sample gives no estimate."""
    rmse = estimate["rmse"]
    return "unknown: one sample" if rmse is None else f"{rmse:.2g}"


def bars(report: dict[str, Any]) -> list[tuple[str, float, float]]:
    """(name, milliseconds, fraction of the longest) of the longest passes, the longest first.

    REST, the time spent outside of passes, counts as a pass. There are at most MOST_BARS in all.
    """
    passes = [(p["name"], p["ms"]) for p in report.get("passes", ())]
    rest = 1000 * report.get("seconds", 0.0) - sum(ms for _, ms in passes)
    found = sorted([*passes, (REST, max(rest, 0.0))], key=lambda item: -item[1])[:MOST_BARS]
    longest = max((ms for _, ms in found), default=0.0)
    return [(name, ms, ms / longest) for name, ms in found if longest > 0]


def stamps(report: dict[str, Any]) -> dict[str, str]:
    """Metadata for the rendered image by field name, as text: the seconds, and the error where it was estimated."""
    found = {"pointsplat/seconds": f"{report['seconds']:.3f}"}
    if "estimate" in report:
        found["pointsplat/error"] = error(report["estimate"])
    return found
