"""Records: what they have in common with dataclasses, and that what they share costs no class anything."""

from dataclasses import FrozenInstanceError, asdict, field, fields, replace
from functools import cached_property

import pytest

from pointsplat_addon.core.numeric.record import record, value_record


@value_record
class Point:
    """With a field that does not count, one that is made, and one that follows from others."""

    x: float
    y: float = 2.0
    names: list[str] = field(default_factory=list, compare=False)
    sum: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sum", self.x + self.y)

    @cached_property
    def twice(self) -> float:
        return 2 * self.sum


@value_record
class Further(Point):
    z: float = 3.0


@record
class Thing:
    parts: list[int]


@value_record
class Nothing:
    pass


def test_fields_are_given_in_order_by_name_or_by_default() -> None:
    assert vars(Point(1.0)) == {"x": 1.0, "y": 2.0, "names": [], "sum": 3.0}
    assert vars(Point(1.0, names=["a"], y=5.0)) == vars(Point(1.0, 5.0, ["a"]))
    assert list(vars(Thing([1]))) == ["parts"]
    assert [f.name for f in fields(Further)] == ["x", "y", "names", "sum", "z"]
    assert Further(1.0, 2.0, ["a"], 9.0).z == 9.0
    assert Point(1.0).names is not Point(1.0).names
    assert Point.y == 2.0


@pytest.mark.parametrize(
    "given", [((), {}), ((1, 2, [], 3), {}), ((1,), {"x": 2}), ((1,), {"w": 2}), ((1,), {"sum": 2})]
)
def test_what_does_not_fit_raises(given: tuple[tuple, dict]) -> None:
    with pytest.raises(TypeError):
        Point(*given[0], **given[1])


def test_records_are_frozen() -> None:
    point = Point(1.0)
    with pytest.raises(FrozenInstanceError):
        point.x = 2.0  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(FrozenInstanceError):
        del point.x
    assert point.twice == 6.0


def test_only_value_records_are_equal_by_their_fields() -> None:
    assert Point(1.0, names=["a"]) == Point(1.0)
    assert hash(Point(1.0, names=["a"])) == hash(Point(1.0))
    assert Point(1.0) != Point(1.5)
    assert Point(1.0) != Further(1.0)
    assert Point(1.0) != 1.0
    assert Nothing() == Nothing()
    assert hash(Nothing()) == hash(Nothing())
    assert Thing([]) != Thing([])
    assert len({Thing([]), Thing([])}) == 2


@value_record
class Own:
    """Equal where parts are one object."""

    parts: list

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Own) and other.parts is self.parts

    def __hash__(self) -> int:
        return id(self.parts)


def test_a_class_keeps_an_equality_of_its_own() -> None:
    parts: list = []
    assert Own(parts) == Own(parts)
    assert Own(parts) != Own([])
    assert hash(Own(parts)) == id(parts)


def test_the_functions_of_dataclasses_take_records() -> None:
    assert replace(Point(1.0, names=["a"]), y=4.0) == Point(1.0, 4.0)
    assert replace(Point(1.0), y=4.0).sum == 5.0
    assert asdict(Thing([1])) == {"parts": [1]}
    assert repr(Further(1.0)) == "Further(x=1.0, y=2.0, names=[], sum=3.0, z=3.0)"


def test_classes_share_their_functions() -> None:
    assert Point.__init__ is Thing.__init__
    assert Point.__hash__ is Nothing.__hash__
