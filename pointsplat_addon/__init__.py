"""PointSplat: a render engine for Blender that draws with points."""

import gc


def register() -> None:
    """Register the engine with Blender, which is not loaded before."""
    # Modules make many objects that stay. Collections meanwhile go through all that Blender has imported, and take a
    # tenth of the time that the import takes without finding anything.
    collects = gc.isenabled()
    gc.disable()
    try:
        from .host import registration
    finally:
        if collects:
            gc.enable()
    registration.register()


def unregister() -> None:
    """Take the engine out of Blender and free all that it holds."""
    from .host import registration

    registration.unregister()
