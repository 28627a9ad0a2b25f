"""PointSplat: a render engine for Blender that draws with points."""


def register() -> None:
    """Register the engine with Blender, which is not loaded before."""
    from .host import registration

    registration.register()


def unregister() -> None:
    """Take the engine out of Blender and free all that it holds."""
    from .host import registration

    registration.unregister()
