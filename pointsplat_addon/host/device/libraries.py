"""Which optional graphics libraries are installed."""

from __future__ import annotations

import importlib.util


def has_moderngl() -> bool:
    """Whether moderngl is installed. Whether it can make a context is only known once the thread has tried."""
    return importlib.util.find_spec("moderngl") is not None
