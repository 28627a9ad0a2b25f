"""What is prepared of scenes, shared by viewports and final renders."""

from __future__ import annotations

from ..render.cache.store import Store

STORE = Store()
