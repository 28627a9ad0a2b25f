"""What is kept on disk between sessions and among processes, in the folder that the preferences name: hierarchies of
points, and what shadows and light need."""

from __future__ import annotations

import logging
import os
from functools import partial
from pathlib import Path

from ..core.lod.hierarchy import LEAF_SIZE, Hierarchy, build
from ..core.lod.quantisation import pack, unpack
from ..core.scene.cloud import PointCloud
from ..formats import file_lock, hierarchy_cache, record_file
from ..formats.whole_file import trim
from ..render.cache.on_disk import OnDisk
from .device import device_costs
from .shared_store import STORE
from .ui import preferences

LOG = logging.getLogger(__name__)
MIN_POINTS = 200_000  # smaller hierarchies are built about as fast as they are read
MAX_BYTES = 8 << 30  # in the folder; the least recently used files are deleted first
SUFFIXES = hierarchy_cache.SUFFIX, record_file.SUFFIX
AT_ONCE = "POINTSPLAT_CACHE_AT_ONCE"  # of the environment: this process prepares a film for others


def refresh() -> None:
    """Apply the preferences. To be called on Blender's main thread before anything is drawn."""
    device_costs.read()
    folder = preferences.cache_folder()
    STORE.build_hierarchy = partial(build_or_read, folder)
    STORE.on_disk = OnDisk(folder, partial(free, folder), bool(os.environ.get(AT_ONCE)))


def free(folder: Path | None, most: int = MAX_BYTES) -> int:
    """Delete the least recently used files of a folder until `most` bytes are left; how many bytes were deleted."""
    return trim(folder, most, SUFFIXES) if folder else 0


def build_or_read(folder: Path | None, cloud: PointCloud) -> Hierarchy:
    """The hierarchy of `cloud`, read from the folder if it is there, else built and written to it. Of several processes
    one builds it and the others wait.

    What was built is quantised as what is read: pictures are the same to the bit whatever a folder holds, and where
    there is none. Errors of the folder are logged, and the hierarchy is built.
    """
    if len(cloud) < MIN_POINTS:
        return build(cloud)
    if folder is None:
        return unpack(pack(build(cloud)))
    key = hierarchy_cache.content_key(cloud, LEAF_SIZE)
    if (found := _known(folder, key)) is not None:
        return found
    with file_lock.held(hierarchy_cache.path_of(folder, key).with_suffix(file_lock.SUFFIX)):
        if (found := _known(folder, key)) is not None:
            return found
        packed = pack(build(cloud))
        try:
            hierarchy_cache.write(folder, key, packed)
            free(folder)
        except OSError as error:
            LOG.warning("A point hierarchy cannot be kept in %s: %s", folder, error)
    return unpack(packed)


def _known(folder: Path, key: str) -> Hierarchy | None:
    try:
        return hierarchy_cache.read(folder, key)
    except (OSError, hierarchy_cache.CacheError) as error:
        LOG.warning("A cached point hierarchy cannot be used: %s", error)
    return None
