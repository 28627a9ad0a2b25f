"""What drawing costs on each device, measured once and kept in the preferences by the device's name and version."""

from __future__ import annotations

import json
import logging
from dataclasses import asdict

import bpy

from ...core.lod.cost import DEFAULT, Costs
from ...render.budget.calibrate import calibrate
from ...render.device.protocol import DeviceError
from ...render.renderer import Renderer
from ..ui import preferences

LOG = logging.getLogger(__name__)
KNOWN: dict[str, Costs] = {}  # by Limits.renderer, which holds the version


def read() -> None:
    """Take over what the preferences hold. Main thread."""
    KNOWN.update({name: costs for name, costs in parsed(preferences.device_costs()).items() if name not in KNOWN})


def write() -> None:
    """Give the preferences what was measured. Main thread."""
    preferences.keep_device_costs(json.dumps({name: asdict(costs) for name, costs in sorted(KNOWN.items())}))


def parsed(text: str) -> dict[str, Costs]:
    """Figures by device; what is no such table, or no positive number, is left out."""
    try:
        found = {str(name): Costs(**{k: float(v) for k, v in row.items()}) for name, row in json.loads(text).items()}
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
        return {}
    return {name: costs for name, costs in found.items() if costs.valid()}


def apply(renderer: Renderer) -> None:
    """The known figures of the renderer's device; where it is new, and a person waits, they are measured. Background
    renders keep the defaults then, so that they do not depend on what else the machine did."""
    name = renderer.device.limits.renderer
    if name not in KNOWN and not bpy.app.background:
        try:
            measure(renderer)
            bpy.app.timers.register(write)  # preferences belong to the main thread
        except DeviceError as error:
            LOG.warning("The device cannot be calibrated: %s", error)
    renderer.costs = KNOWN.get(name, DEFAULT)


def measure(renderer: Renderer) -> Costs:
    """Measure on the renderer's own thread, and know it from then on. DeviceError: it cannot draw."""
    KNOWN[renderer.device.limits.renderer] = renderer.costs = calibrate(renderer)
    return renderer.costs
