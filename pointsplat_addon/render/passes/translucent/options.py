"""Which attributes the translucent splats of a view have: shader variants of their passes."""

from __future__ import annotations

from ....core.numeric.record import value_record
from ....core.scene.cloud import PointCloud
from ....core.scene.materials import MaterialTable
from ..shading.terms import Term


@value_record
class TranslucentOptions:
    """What translucent splats have beyond geometry and optical depth."""

    media: bool = False  # some fill a volume
    gathered: bool = False  # and what light falls on these is known: render/indirect/media.py
    color: bool = False
    surface: bool = False
    emission: bool = False
    tint: bool = False  # some extinction or opacity differs between the channels
    shaded: bool = False  # and some of it absorbs
    shading_normal: bool = False
    kernels: bool = False  # some have another kernel than the default
    holdout: bool = False  # some cut holes
    opaque: bool = False  # something opaque may hide them
    fuzzy: bool = False  # some are opaque: core/splat/painter.py
    cull: bool = False  # and some of these are not drawn where they show their backs
    disconnected: bool = False  # and some of these stand apart: core/lod/foliage.py
    defocus: bool = False  # for the pass of what is out of focus: passes/defocus/gather.py
    grouped: bool = False  # they are blended over groups of sub-samples, and lit once for all of these
    strands: bool = False  # some of these splats are pieces of strands: core/lens/strand_splats.py
    captured: bool = False  # some are captured splats: passes/captured; then all are looked at in pixels' centres
    alone: bool = False  # and there are no others
    nodes: bool = False  # and some are nodes that stand for many: core/lod/captured
    depth: bool = False  # the pass Depth asks for captured splats: passes/captured/half_depth.py
    trained: bool = False  # they are blended in display values, as training did, over the world alone
    term: Term | None = None  # of light, that is drawn alone; None: all of it
    mattes: bool = False  # meshes stand for the surfaces of some captured splats
    slopes: bool = (
        False  # their planes tell which lies before which: some are surfaces that light passes, and out of focus
    )
    received: bool = False  # what surfaces among them receive from each other and the sky is known

    @property
    def centred(self) -> bool:
        """Whether all are looked at in pixels' centres. Coloured extinction has three transmittances: what blending
        changes is then told by what it began with."""
        return self.captured and not self.tint

    @property
    def fronts(self) -> bool:
        """Whether depths across each splat are known, not only those of centres."""
        return (self.opaque or self.depth) and not self.defocus

    @property
    def open_apart(self) -> bool:
        """Whether what is open is a layer that is blended apart from others: nothing opaque is looked up for it."""
        return self.alone and self.grouped and not self.holdout

    @property
    def tiled(self) -> bool:
        """Whether draws of all splats leave out those that touch no tile in which they are wanted."""
        return self.captured and self.grouped

    @property
    def attributes(self) -> tuple[tuple[str, bool], ...]:
        names = ("color", "surface", "emission", "tint", "shaded", "shading_normal")
        return tuple((name, getattr(self, name)) for name in names)


def options(
    clouds: list[PointCloud],
    table: MaterialTable,
    opaque: bool,
    holdout: bool = False,
    defocus: bool = False,
    grouped: bool = False,
    captured: bool = False,
    nodes: bool = False,
) -> TranslucentOptions:
    """Returns the options that these clouds need. `opaque`: something opaque is drawn, too. `holdout`: an instance of
    them cuts a hole. `defocus`: for what is out of focus. `grouped`: they are drawn among groups of sub-samples.
    `captured`: captured splats are among them, and `nodes` that stand for many of these."""
    fuzzy = any(is_fuzzy(c) for c in clouds)
    return TranslucentOptions(
        media=any(c.extinction is not None for c in clouds),
        color=any(c.color is not None for c in clouds),
        surface=any(c.surface is not None for c in clouds),
        emission=any(c.emission is not None for c in clouds)
        or (any(c.extinction is None for c in clouds) and bool((table.emission > 0).any())),
        tint=any(_is_colored(c) for c in clouds),
        shaded=any(c.shaded is not None for c in clouds),
        shading_normal=any(c.shading_normal is not None for c in clouds),
        kernels=not defocus and any(c.kernel is not None for c in clouds),
        holdout=holdout,
        opaque=opaque,
        fuzzy=fuzzy,
        cull=fuzzy and bool(table.cull.any()),
        disconnected=not defocus and any(is_fuzzy(c) and c.disconnected is not None for c in clouds),
        defocus=defocus,
        slopes=defocus and any(c.opacity is not None and c.extinction is None for c in clouds),
        grouped=grouped,
        strands=defocus and any(is_fuzzy(c) and c.kernel is not None for c in clouds),
        captured=captured,
        alone=captured and not clouds,
        nodes=nodes,
    )


def lit_outputs(options: TranslucentOptions) -> tuple[str, ...]:
    """Returns what is written of each splat before it is blended: see light.py."""
    front = ("front",) if options.fronts else ()
    slope = ("slope",) if options.slopes else ()
    return ("centre", "shape", "source", *front, *slope, *(("tint",) if options.tint else ()))


def _is_colored(cloud: PointCloud) -> bool:
    """Returns whether what the splats of a cloud hide may differ between the channels."""
    return any(matter is not None and matter.ndim == 2 for matter in (cloud.opacity, cloud.extinction))


def is_fuzzy(cloud: PointCloud) -> bool:
    """Returns whether the splats of a cloud are opaque, but for their rims."""
    return cloud.extinction is None and cloud.opacity is None
