"""Frozen dataclasses that cost next to nothing to define.

`dataclass(frozen=True)` writes and compiles the functions of each class anew, six of them and most of a millisecond;
with two hundred classes that was half of what importing the add-on took. Here all classes share theirs, which read the
fields. `fields`, `replace` and `asdict` of dataclasses, inheritance, `field` and `__post_init__` work as ever.
"""

from __future__ import annotations

from dataclasses import MISSING, FrozenInstanceError, dataclass, field, fields
from typing import Any, TypeVar, dataclass_transform

T = TypeVar("T")

_with_fields = dataclass(init=False, repr=False, eq=False, match_args=False)


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
def record(cls: type[T]) -> type[T]:
    """Makes a frozen dataclass of a class. Instances are equal to themselves alone."""
    cls.__doc__ = cls.__doc__ or ""  # or dataclass() would write the signature there
    made: Any = _with_fields(cls)
    found = fields(made)
    made._names = tuple(f.name for f in found if f.init)
    made._defaults = {f.name: f.default for f in found if f.init and f.default is not MISSING}
    made._factories = {f.name: f.default_factory for f in found if f.default_factory is not MISSING}
    for name, function in SHARED.items():
        if name not in cls.__dict__:
            setattr(made, name, function)
    return made


@dataclass_transform(frozen_default=True, eq_default=True, field_specifiers=(field,))
def value_record(cls: type[T]) -> type[T]:
    """Makes a frozen dataclass of a class.

    Instances with equal fields are equal and have the same hash, unless the class has functions of its own for that.
    """
    made: Any = record(cls)
    made._compared = tuple(f.name for f in fields(made) if f.compare)
    for name, function in {"__eq__": _equal, "__hash__": _hash}.items():
        if cls.__dict__.get(name) is None:  # a class with an __eq__ of its own and no hash has None there
            setattr(made, name, function)
    return made


# ---------------------------------------------------------------------------- what all records share


def _init(self: Any, *given: Any, **named: Any) -> None:
    names, values = self._names, self.__dict__
    values.update(zip(names, given, strict=False))
    if len(given) < len(names):
        defaults, factories = self._defaults, self._factories
        for name in names[len(given) :]:
            if name in named:
                values[name] = named.pop(name)
            elif name in defaults:
                values[name] = defaults[name]
            elif name not in factories:
                raise TypeError(f"{type(self).__name__}() needs {name!r}")
    if named or len(given) > len(names):
        extra = ", ".join(map(repr, named)) or f"{len(given)} values for {len(names)} fields"
        raise TypeError(f"{type(self).__name__}() got what it does not take: {extra}")
    for name, make in self._factories.items():
        if name not in values:
            values[name] = make()
    if hasattr(self, "__post_init__"):
        self.__post_init__()


def _repr(self: Any) -> str:
    shown = ", ".join(f"{f.name}={getattr(self, f.name)!r}" for f in fields(self) if f.repr)
    return f"{type(self).__qualname__}({shown})"


def _set(self: Any, name: str, value: Any) -> None:
    raise FrozenInstanceError(f"cannot assign to field {name!r}")


def _delete(self: Any, name: str) -> None:
    raise FrozenInstanceError(f"cannot delete field {name!r}")


def _equal(self: Any, other: object) -> bool:
    if other.__class__ is not self.__class__:
        return NotImplemented
    mine, theirs = self.__dict__, other.__dict__
    return all(mine[name] is theirs[name] or mine[name] == theirs[name] for name in self._compared)


def _hash(self: Any) -> int:
    return hash(tuple(map(self.__dict__.__getitem__, self._compared)))


SHARED = {"__init__": _init, "__repr__": _repr, "__setattr__": _set, "__delattr__": _delete}
