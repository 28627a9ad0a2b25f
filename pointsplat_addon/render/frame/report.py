"""Reports how a picture was drawn: its passes, their time, and what was left out."""

from __future__ import annotations

from typing import Any

from ..plan.reasons import not_run
from .frame import Frame


def report(frame: Frame, seconds: float) -> dict[str, Any]:
    """Returns the report of a picture, as scripts/render.py writes it; `seconds`: the time that the picture took."""
    frame_plan, device, spent = frame.frame_plan, frame.device, _spent(frame)
    drawn = 0 if frame_plan.trivial else sum(lines.drawn for lines in frame.uploads.strands.draws)
    return {
        "device": f"{device.name}: {device.limits.renderer}",
        "seconds": seconds,
        "passes": [{"name": name, "ms": round(ms, 3)} for name, ms in spent.items()],
        "skipped": [{"name": name, "because": why} for name, why in (*_skipped(frame, spent), *_samples(frame))],
        "points": {
            "total": frame_plan.prepared.total,
            "cut": frame_plan.splats,
            "drawn": frame_plan.splats * (frame.done - frame.first),
        },
        "samples": (frame.done - frame.first) * max(frame_plan.plan.sub_samples, 1),
        "technique": {"name": frame_plan.technique.name, "because": frame_plan.technique.because},
        "triangles": frame_plan.triangles,
        "lines": {"strands": frame_plan.strands, "segments": frame_plan.segments, "drawn": drawn},
        "bytes": {"cpu": frame.renderer.store.nbytes, "gpu": device.bytes_allocated()},
        **({} if frame_plan.streamed is None else {"streamed": frame_plan.streamed.report}),
        "warnings": list(frame_plan.warnings),
    }


def _spent(frame: Frame) -> dict[str, float]:
    """Returns milliseconds by pass, including those of the auxiliary picture without a lens."""
    clock = frame.clock
    clock.settle()
    beside = {} if frame.beside is None else _spent(frame.beside)
    return clock.spent | {name: ms + clock.spent.get(name, 0.0) for name, ms in beside.items()}


def _skipped(frame: Frame, ran: dict[str, float]) -> list[tuple[str, str]]:
    """Returns the passes that did not run, and why."""
    frame_plan = frame.frame_plan
    reaches = frame_plan.trivial or frame.uploads.translucent is None or frame.uploads.translucent.shared_lights > 0
    return not_run(frame_plan.left_out, ran.keys(), frame_plan.trivial, frame_plan.not_adaptive, reaches)


def _samples(frame: Frame) -> list[tuple[str, str]]:
    """Returns the reason if the picture has fewer samples than requested; else an empty list."""
    frame_plan, asked = frame.frame_plan, frame.frame_plan.request.samples
    if frame.ended:
        return [("samples", f"the budget asks for no more than {frame.done}")]
    if frame_plan.trivial or frame_plan.not_adaptive or frame.adaptive is None:
        return []
    mean = float(frame.counts().mean())
    return [("samples", f"pixels have {mean:.1f} of {asked}: the others would agree")] if mean < asked else []
