"""The light of a view that stood still, for others of the same scene."""

from __future__ import annotations

from ...core.scene.scene import Scene
from ...core.scene.settings import Settings
from ..frame.indirect.kept import scene_content
from ..indirect.light import IndirectLight
from .protocol import SampleRenderer


class KnownLight:
    """Indirect light that was brought into a view, for others of the same scene until theirs is there: what it is
    estimated from. Nothing of it depends on where the camera is."""

    def __init__(self, renderer: SampleRenderer, scene: Scene, settings: Settings, light: IndirectLight) -> None:
        """`scene`, `settings`: that a view shows."""
        self.light = light
        self._kept, self._scene, self._settings = renderer.kept, scene, settings
        self._content = scene_content(scene, renderer.store)
        self._used = self._kept.begin()
        if light.key is not None:
            self._used.add(light.key)

    def is_of(self, renderer: SampleRenderer, scene: Scene, settings: Settings) -> bool:
        """Whether it is the light of what a view shows, wherever its camera is."""
        key = self.light.key
        if settings != self._settings or renderer.kept is not self._kept or key is None or key not in self._kept:
            return False
        if scene is not self._scene:
            if scene_content(scene, renderer.store) != self._content:
                return False
            self._scene = scene
        return True

    def release(self) -> None:
        """Lets the device free it."""
        self._kept.end(self._used)
