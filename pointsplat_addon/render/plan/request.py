"""What is asked of the renderer, and what it hands back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.scene.camera import Camera
from ...core.scene.settings import Settings
from ...core.splat.blur import NODE_SIZE


@dataclass(frozen=True)
class Request:
    """What one picture needs."""

    camera: Camera
    settings: Settings
    passes: frozenset[str]  # keys of outputs.PASSES; combined is always there
    samples: int
    crypto_levels: int = 6
    interactive: bool = False  # drawn again and again, and at once: see prepare
    coarse: bool = False  # a budget of time has no room for one sample at the tolerance that was asked for
    node: float = NODE_SIZE  # largest nodes of what is out of focus, over the radii of their disks: core/lens/kernel.py


@dataclass(frozen=True)
class Result:
    """Pictures (H, W, C) float32 by pass, bottom row first, and the report."""

    pixels: dict[str, np.ndarray]
    report: dict[str, Any]
    cancelled: bool = False
