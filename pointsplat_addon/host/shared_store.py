"""The store of prepared scenes that viewports and final renders share."""

from __future__ import annotations

from ..render.cache.store import Store

STORE = Store()
