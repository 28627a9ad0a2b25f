"""Keys of cached items: what kind of thing an item is, and everything that it depends on."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Iterator
from enum import Enum, auto
from typing import NamedTuple


class Kind(Enum):
    """What a cached item is. The comment says of what; `Key.content` names that by its content key or its own key."""

    # Of any geometry
    VALIDATED = auto()  # data without what cannot be drawn, and what was wrong with it
    # Of a scene
    CROWD = auto()  # cells of many instances, with boxes
    # Of a mesh
    TYPICAL_EDGE = auto()
    BOUNDING_BALL = auto()  # of the valid triangles
    SURVEY = auto()  # some vertices, and the area
    COARSE_MESH = auto()  # with one vertex in each cell of a grid
    PARTS = auto()  # runs of triangles with bounds
    MEASURES = auto()  # of triangles, for sampling
    IS_FOLIAGE = auto()
    IS_CLOSED = auto()
    IS_INSIDE_OUT = auto()  # closed, with fronts that look inwards
    IS_SOLID = auto()  # closed but for small gaps
    DIVIDED_MESH = auto()  # parts and measures
    SPLIT_BY_MATERIAL = auto()  # an opaque and a translucent mesh
    LIMITED_SPACING = auto()  # the finest that a number of samples allows
    FINEST_SPACING = auto()  # that was asked for so far
    SAMPLING_METHOD = auto()
    SAMPLES = auto()  # where on the mesh samples lie: its topology decides
    SAMPLES_OF_PARTS = auto()
    # Of curves and volumes
    CLEAN_STRANDS = auto()  # without what cannot be drawn
    CROSSED_HAIRS = auto()  # how many hairs light crosses
    VOXELS = auto()  # the points of a volume
    EVEN_BLOCKS = auto()  # those with even blocks merged, up to a level
    BOX = auto()  # corners of what holds a geometry with its radii
    # Clouds of points
    MESH_POINTS = auto()  # samples with their attributes
    POINTS_OF_PARTS = auto()
    COHERENT_POINTS = auto()  # of a cloud, finite and in coherent order
    CLOUD = auto()  # the point set of a given cloud
    FILLED = auto()  # points with the constants of their materials
    DICED = auto()  # splats of one view, cut from what is out of focus
    STREAMED = auto()  # what a view draws of a scan that is read by pages
    # Of point sets
    HIERARCHY = auto()
    SHARED_HIERARCHY = auto()  # of samples that several poses or colourings share
    NODES = auto()  # key of points that got a hierarchy for coarse views
    NODES_ASKED_FOR = auto()
    LEVELS = auto()  # of a hierarchy, for many instances
    LEVEL_NODES = auto()  # the nodes of these levels, as a point set
    FAR_NODES = auto()  # over the surface of a mesh, of one size, as a point set
    BALL_TREE = auto()  # nodes over balls, for the visibility buffer; and its balls, as a point set
    BALL_NODES = auto()  # the nodes of such a tree, as a point set
    FOREST = auto()  # hierarchies of several point sets, cut together
    BALL_AND_RADIUS = auto()
    TYPICAL_RADIUS = auto()
    MATERIAL_ROWS = auto()  # that points name; the first row where they name none
    BRIGHTEST_COLOR = auto()
    IS_INVISIBLE = auto()
    AREA_SHARES = auto()  # covered fraction of each splat's ellipse
    # Of captured splats
    CAPTURED_TREE = auto()  # nodes that stand for many
    CAPTURED_TREE_ASKED_FOR = auto()
    LARGEST_SCALES = auto()  # of each
    CAPTURED_NORMALS = auto()  # of each
    CAPTURED_NODE_NORMALS = auto()
    # Of shadows
    CASTER_BALL = auto()
    CASTER_BOX = auto()
    CASTER_PLANE = auto()
    CASTER_BODY = auto()  # planes of a closed, convex mesh
    CASTER_EXTENTS = auto()
    CASTER_POSITIONS = auto()  # points all over a mesh
    CASTER_SAMPLES = auto()
    CASTER_NODES = auto()
    FLOORS = auto()  # which casters have nothing behind them
    CASTER_SPACINGS = auto()
    CASTERS = auto()  # all of a scene: a part of other keys only
    SHADOW_TABLE = auto()  # of one light
    SHADOW_TABLES = auto()  # of all lights, packed for the device
    SHADOW_MAPS = auto()  # the views of all depth maps
    NESTED_MAPS = auto()  # and of those that are nested in them, for a camera
    SKETCH = auto()  # of a geometry, by which is found what is seen
    PANE_MAPS = auto()  # those of panes
    PANE_FACES = auto()  # and the faces of these
    # On the device
    PAGE = auto()
    TRANSLUCENT_PAGE = auto()
    STRAND_PAGE = auto()
    CAPTURED_PAGE = auto()
    CAPTURED_NODE_PAGE = auto()
    CAPTURED_ORDER = auto()  # of the captured splats of one of the frames in the making
    POLYGON_MESH = auto()
    POLYGON_PAGE = auto()  # of many small meshes
    TEXTURES = auto()  # of a material graph
    ENVIRONMENT = auto()
    ENVIRONMENT_LEVELS = auto()
    SHADOW_TEXTURE = auto()
    SHADOW_MAP_TEXTURE = auto()
    PANE_TEXTURE = auto()
    DRAW_ORDER = auto()  # of the translucent splats of one of the frames in the making
    LIGHT_SHARES = auto()  # that reach the translucent splats of one of the frames in the making
    LIGHT_BAKER = auto()  # surfels that are being lit
    LIGHT_TREE = auto()  # of all that hides or scatters light, with what leaves it
    TRACED_TRIANGLES = auto()  # of all that sharp mirrors show
    # Of the world
    IMAGE_DIGEST = auto()
    # Of the host
    IMAGE = auto()
    WORLD = auto()  # the picture of a graph of nodes

    # Members are singletons; Enum's own hash runs in Python.
    __hash__ = object.__hash__


class Key(NamedTuple):  # hashed and compared many times a frame for each geometry, which tuples are without Python
    """What an item is and what it depends on; two keys are equal if all of it is."""

    kind: Kind
    content: Hashable  # what the item was made from: a content key, the key of another item, or a tuple of these
    look: str = ""  # digest of the materials
    method: str = ""  # of sampling a mesh
    spacing: float = 0.0  # of samples, object units
    other: Hashable = ()  # what else it depends on


STREAMED_NAME = "streamed "  # content keys of what a view draws of a scan that is read by pages begin with it


def streamed_names(of: object) -> Iterator[str]:
    """Yields the content keys of what views draw of scans read by pages that a key, or what it depends on, names."""
    if isinstance(of, str):
        if of.startswith(STREAMED_NAME):
            yield of
    elif isinstance(of, Key):
        yield from streamed_names(of.content)
        yield from streamed_names(of.other)
    elif isinstance(of, tuple):
        for one in of:
            yield from streamed_names(one)


def digest(of: object) -> bytes:
    """A short hash of numbers, names and bytes in nested tuples, so that keys do not hold whole arrays."""
    return hashlib.blake2b(repr(of).encode(), digest_size=16).digest()
