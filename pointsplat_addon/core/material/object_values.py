"""Values of objects that materials read, by the names that expressions and instances know them by."""

from __future__ import annotations

# Of each value how many components it has
COMPONENTS = {
    "location": 3,  # of the object's origin in world space
    "color": 4,  # with alpha
    "index": 1,  # the pass index
    "random": 1,  # in [0, 1]
    "matrix": 12,  # world_from_object, three rows of four
}
ATTRIBUTE = "attribute "  # begins the names of attributes, which are colours with alpha: type and name follow
POINT_RADIUS, POINT_RANDOM = "point:radius", "point:random"  # attributes of points: outputs of the Point Info node
SPACE = "space "  # begins the names of other objects' object_from_world, three rows of four: a number follows


def components(name: str) -> int:
    """How many components a value has."""
    return 12 if name.startswith(SPACE) else COMPONENTS.get(name, 4)


def attribute_value(kind: str, name: str) -> str:
    """The name of the value of an attribute. kind: OBJECT, INSTANCER or VIEW_LAYER."""
    return f"{ATTRIBUTE}{kind} {name}"
