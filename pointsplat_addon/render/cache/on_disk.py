"""What pictures need of lights and geometry, kept in a folder that processes and machines share.

A film whose lights and casters stand still needs the same shadows in each of its frames, which farms draw by processes
of their own. What moves has another key in each frame, and would only fill the folder: an item is written where it is
made a second time. What was made once leaves a mark, if making it takes longer than reading it would. Items that were
read are those that were made, to the bit.
"""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from ...formats import file_lock, record_file
from ...formats.code_version import arithmetic
from .keys import streamed_names

LOG = logging.getLogger(__name__)
MARKS = "seen"  # folder of marks: each is a file with the key that was seen last of all with the same first digits
MARK_DIGITS = 3  # hexadecimal: so many marks are kept at most, 16 to that power
LEAST_SECONDS = 0.2  # what took less to make is not kept
BYTES_PER_SECOND = 150e6  # that are read at least, checked and uploaded: as a network of a gigabit brings

T = TypeVar("T")


class UnstableError(TypeError):
    """A key that another process would not find: it holds something that is told apart by identity alone."""


class Form(Generic[T]):
    """How an item of some kind becomes what `record_file` keeps, and an item again."""

    def __init__(
        self,
        save: Callable[[T], Any],
        load: Callable[[Any], T],
        classes: Mapping[str, type],
        settle: Callable[[T], int],
    ) -> None:
        """`save`: returns None where an item cannot be kept. `classes`: of its records, by name. `settle`: waits until
        it is made, and returns about how many bytes it has."""
        self.save, self.load, self.classes, self.settle = save, load, classes, settle


def form_of_records(*classes: type) -> Form[Any]:
    """The form of records of arrays, which are kept as they are; None is not kept."""
    return Form(
        lambda item: item,
        lambda item: item,
        {one.__name__: one for one in classes},
        lambda item: 0 if item is None else record_file.nbytes(item),
    )


class OnDisk:
    """Items in a folder, by everything that they depend on."""

    def __init__(self, folder: Path | None, free: Callable[[], object], at_once: bool = False) -> None:
        """`folder`: None: nothing is kept. `free`: makes room there after something was written. `at_once`: items are
        written where they are made for the first time: others will need them."""
        self._folder, self._free, self._at_once = folder, free, at_once

    def lookup(self, key: object, make: Callable[[], T], form: Form[T], driver: str = "") -> T:
        """Returns the item of `key`: read if it is kept, else made. `driver`: of the device that makes it.

        Errors of the folder are logged, and the item is made.
        """
        if self._folder is None:
            return make()
        try:
            name = hashlib.blake2b(f"{text_of(key)} {driver} {arithmetic()}".encode(), digest_size=20).hexdigest()
        except UnstableError:
            return make()
        path = self._folder / (name + record_file.SUFFIX)
        if (known := self._known(path, form)) is not None:
            return form.load(known)
        if not (self._at_once or path.exists() or self._seen(name)):
            item, took, size = _made(make, form)
            if _pays(took, size):
                self._mark(name)
            return item
        with file_lock.held(path.with_suffix(file_lock.SUFFIX)):
            if (known := self._known(path, form)) is not None:
                return form.load(known)
            item, took, size = _made(make, form)
            if _pays(took, size):
                self._write(path, form, item)
            return item

    def _known(self, path: Path, form: Form[T]) -> Any:
        """What a file holds; None if it is not there, or cannot be used."""
        try:
            return record_file.read(path, form.classes)
        except (OSError, record_file.RecordError) as error:
            LOG.warning("A cached item cannot be used: %s", error)
        return None

    def _write(self, path: Path, form: Form[T], item: T) -> None:
        saved = form.save(item)
        if saved is None:
            return
        try:
            record_file.write(path, saved)
            self._free()
        except OSError as error:
            LOG.warning("Nothing can be kept in %s: %s", path.parent, error)

    def _mark_path(self, name: str) -> Path:
        assert self._folder is not None
        return self._folder / MARKS / name[:MARK_DIGITS]

    def _seen(self, name: str) -> bool:
        try:
            return self._mark_path(name).read_text(encoding="ascii", errors="replace") == name
        except OSError:
            return False

    def _mark(self, name: str) -> None:
        path = self._mark_path(name)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(name, encoding="ascii")  # torn, it is that of no key
        except OSError as error:
            LOG.warning("Nothing can be kept in %s: %s", path.parent, error)


NOWHERE = OnDisk(None, lambda: None)


def _made(make: Callable[[], T], form: Form[T]) -> tuple[T, float, int]:
    """An item, the seconds that making it took, and about its bytes."""
    before = time.perf_counter()
    item = make()
    size = form.settle(item)
    return item, time.perf_counter() - before, size


def _pays(took: float, size: int) -> bool:
    return took > LEAST_SECONDS + size / BYTES_PER_SECOND


def text_of(of: object) -> str:
    """A text that tells keys apart, the same in every process. UnstableError: there is none.

    Keys of what a view draws of a scan read by pages have none either: another view draws other pages.
    """
    if next(streamed_names(of), None) is not None:
        raise UnstableError("pages of a scan")
    return _text(of)


def _text(of: object) -> str:
    if of is None or isinstance(of, str | bytes | bool | int | float | np.generic):
        return repr(of)
    if isinstance(of, Enum):
        return of.name
    if isinstance(of, tuple | list):
        return f"({', '.join(map(_text, of))})"
    if is_dataclass(of) and not isinstance(of, type):
        return f"{type(of).__name__}({', '.join(_text(getattr(of, f.name)) for f in fields(of))})"
    raise UnstableError(type(of).__name__)
