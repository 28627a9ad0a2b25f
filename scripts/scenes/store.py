"""What renderers of a process share of prepared scenes, so that a scene is not prepared again for each device."""

from __future__ import annotations

from pointsplat_addon.render.cache.store import Store

STORE = Store()
