"""Measured costs of drawing on each device, stored in the preferences by the device's name and version."""

from __future__ import annotations

import json
import logging
from dataclasses import asdict

import bpy

from ...core.lod.cost import DEFAULT, Costs
from ...core.scene.settings import Settings
from ...render.budget.calibrate import calibrate
from ...render.device.protocol import DeviceError
from ...render.renderer import Renderer
from ..ui import preferences

LOG = logging.getLogger(__name__)
KNOWN: dict[str, Costs] = {}  # by Limits.renderer, which contains the version


def read() -> None:
    """Add the costs that the preferences have to those that are known. To be called on the main thread."""
    KNOWN.update({name: costs for name, costs in parsed(preferences.device_costs()).items() if name not in KNOWN})


def write() -> None:
    """Store the known costs in the preferences. To be called on the main thread."""
    preferences.keep_device_costs(json.dumps({name: asdict(costs) for name, costs in sorted(KNOWN.items())}))


def parsed(text: str) -> dict[str, Costs]:
    """Costs by device from JSON text; invalid entries are left out."""
    try:
        found = {str(name): Costs(**{k: float(v) for k, v in row.items()}) for name, row in json.loads(text).items()}
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
        return {}
    return {name: costs for name, costs in found.items() if costs.valid()}


def matter(settings: Settings) -> bool:
    """Whether costs may decide anything in a picture: the visibility buffer draws meshes by triangles in any case."""
    by_buffer = settings.technique in ("AUTO", "VISIBILITY")
    return not by_buffer or settings.budget != "NONE" or settings.dof_method == "LENS_SAMPLES"


def apply(renderer: Renderer, settings: Settings) -> None:
    """Give the renderer the costs of its device, measured now if they are not known and may matter.

    Background renders use the defaults instead of measuring, so that they do not depend on what else the machine does.
    """
    name = renderer.device.limits.renderer
    if name not in KNOWN and matter(settings) and not bpy.app.background:
        try:
            measure(renderer)
            bpy.app.timers.register(write)  # preferences belong to the main thread
        except DeviceError as error:
            LOG.warning("The device cannot be calibrated: %s", error)
    renderer.costs = KNOWN.get(name, DEFAULT)


def measure(renderer: Renderer) -> Costs:
    """Measure the costs of the renderer's device and use them from now on. Raises DeviceError if it cannot draw.

    To be called on the thread of the renderer.
    """
    KNOWN[renderer.device.limits.renderer] = renderer.costs = calibrate(renderer)
    return renderer.costs
