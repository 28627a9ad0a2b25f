"""Point hierarchies kept on disk between sessions, in the folder that the preferences name."""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path

from ..core.lod.hierarchy import LEAF_SIZE, Hierarchy, build
from ..core.scene.cloud import PointCloud
from ..formats import hierarchy_cache
from .device import device_costs
from .shared_store import STORE
from .ui import preferences

LOG = logging.getLogger(__name__)
WORTH_KEEPING = 200_000  # points; smaller hierarchies are built about as fast as they are read
MOST_BYTES = 8 << 30  # in the folder; the files that were used longest ago go first


def refresh() -> None:
    """Follow the preferences. Called on Blender's main thread before anything is drawn."""
    device_costs.read()
    folder = preferences.cache_folder()
    STORE.build_hierarchy = build if folder is None else partial(build_or_read, folder)


def build_or_read(folder: Path, cloud: PointCloud) -> Hierarchy:
    """The hierarchy of `cloud`, from the folder where it is there; a folder that fails only costs time."""
    if len(cloud) < WORTH_KEEPING:
        return build(cloud)
    key = hierarchy_cache.content_key(cloud, LEAF_SIZE)
    try:
        found = hierarchy_cache.read(folder, key)
        if found is not None:
            return found
    except (OSError, hierarchy_cache.CacheError) as error:
        LOG.warning("A cached point hierarchy cannot be used: %s", error)
    built = build(cloud)
    try:
        hierarchy_cache.write(folder, key, built)
        hierarchy_cache.trim(folder, MOST_BYTES)
    except OSError as error:
        LOG.warning("A point hierarchy cannot be kept in %s: %s", folder, error)
    return built
