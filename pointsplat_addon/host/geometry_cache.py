"""Converted geometry by content key, and the rows of materials, shared by all scenes of a Blender session."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from typing import Any

import bpy


class GeometryCache:
    """Geometry by content key, shared by final renders and viewports; it lives as long as any scene holds it."""

    def __init__(self) -> None:
        self._geometry: weakref.WeakValueDictionary[str, Any] = weakref.WeakValueDictionary()
        self._rows: dict[int, int] = {}
        self._lock = threading.Lock()

    def lookup(self, key: str, make: Callable[[], Any]) -> Any:
        """The object with that content key, made if it is not known.

        It is made outside the lock: two threads may both make it, and one of the two objects is kept.
        """
        with self._lock:
            known = self._geometry.get(key)
        if known is not None:
            return known
        made = make()
        with self._lock:
            return self._geometry.setdefault(key, made)

    def row(self, material: bpy.types.Material | None) -> int:
        """The material's row in the table of every scene; 0 for None.

        A row stays until `clear`, so that the content keys of meshes stay too.
        """
        if material is None:
            return 0
        with self._lock:
            return self._rows.setdefault(material.original.session_uid, len(self._rows) + 1)

    def rows(self) -> int:
        """The number of rows that have been given, the default material's included."""
        return len(self._rows) + 1

    def clear(self) -> None:
        """Forget everything, for instance when a file is loaded."""
        with self._lock:
            self._geometry.clear()
            self._rows.clear()


CACHE = GeometryCache()
