"""A `Case`: a scene together with the camera and the settings that it is drawn with."""

from __future__ import annotations

from dataclasses import dataclass, field

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.passes.outputs import PASSES
from pointsplat_addon.render.plan.request import Request

ALL_PASSES = frozenset(p.key for p in PASSES)


@dataclass(frozen=True, eq=False)
class Case:
    """A scene, and how it is seen."""

    scene: Scene
    camera: Camera
    settings: Settings = field(
        default_factory=lambda: Settings(technique="IMAGE_SPACE", use_shadows=False)
    )  # the reference has none

    def request(self, passes: frozenset[str] = ALL_PASSES, samples: int = 1) -> Request:
        return Request(self.camera, self.settings, passes, samples)
