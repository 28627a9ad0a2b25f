"""Scenes as they can be drawn, of which what was found is kept."""

from __future__ import annotations

from ...core.scene.camera import Camera
from ...core.scene.scene import Scene
from ...core.scene.validation import validate
from ..cache.keys import Key, Kind
from ..cache.store import Store


def validated(scene: Scene, camera: Camera, store: Store) -> tuple[Scene, Camera]:
    """Returns a scene and a camera that can be drawn: core/scene/validation.py."""
    return validate(
        scene,
        camera,
        lambda contents, make: store.lookup_all([Key(Kind.VALIDATED, content) for content in contents], make),
    )
