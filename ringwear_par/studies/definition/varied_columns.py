"""The cases of a study by column, and in groups; their texts: one template, with places."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.numbers import Number, interval_of
from ringwear_par.cases.schema import unit_under
from ringwear_par.files.text import toml_text
from ringwear_par.studies.definition.variations import (
    Column,
    path_of,
    split_key,
    value_of,
    varied_keys,
)

_PLACE = re.compile("\0([0-9]+)\0")  # no text of a case has a zero byte


class Place:
    """Stands in a case's keys for the value of a column, by its number."""

    def __init__(self, column: int) -> None:
        self._column = column

    def __str__(self) -> str:
        return f"\0{self._column}\0"


@dataclass(frozen=True)
class Frame:
    """A text with places for values."""

    #: the texts before, between and after them
    pieces: tuple[str, ...]
    #: numbers of the columns that the values come from
    columns: tuple[int, ...]

    @classmethod
    def of(cls, keys: Mapping[str, Any]) -> "Frame":
        """Return the frame of dotted keys, some of whose values are a Place."""
        pieces = _PLACE.split(toml_text(keys))
        return cls(tuple(pieces[::2]), tuple(map(int, pieces[1::2])))

    def filled(self, values: Sequence[str]) -> str:
        """Return the text with values, as TOML writes them, in its places."""
        words = [""] * (2 * len(self.pieces) - 1)
        words[::2], words[1::2] = self.pieces, values
        return "".join(words)


@dataclass(frozen=True, eq=False)
class CaseColumns:
    """The cases of a study, or a stretch of them, by column.

    Cases whose columns differ in numbers only (see ``cases.numbers``) are of one kind.
    """

    #: dotted keys and raw values of the base case
    base: Mapping[str, Any]
    #: the varied keys
    names: tuple[str, ...]
    #: raw values, in the order of ``names``
    columns: tuple[Column, ...]
    #: which columns are numbers of a case in all cases of the study, whatever the others are: a
    #: stretch of it has no more
    numbers: Mapping[Number, int]

    @classmethod
    def of(
        cls, base: Mapping[str, Any], names: tuple[str, ...], columns: tuple[Column, ...]
    ) -> "CaseColumns":
        """Return all cases of a study."""
        numbers: dict[Number, int] = {}
        paths = {*base, *map(path_of, names)}
        for i, (path, entry) in enumerate(map(split_key, names)):
            if isinstance(entry, int) or columns[i].numbers is None:
                continue
            body, _, name = path.partition(".")
            if name == "young" and f"{body}.layers" in paths:
                continue  # of other layers: no one factor of the elasticity
            if interval_of((path, entry)) is not None:
                numbers[path, entry] = i
        return cls(base, names, columns, numbers)

    def __len__(self) -> int:
        return len(self.columns[0])

    def part(self, cases: slice | IntArray) -> "CaseColumns":
        """Return some of the cases."""
        columns = tuple(column.part(cases) for column in self.columns)
        return CaseColumns(self.base, self.names, columns, self.numbers)

    def keys(self, case: int, places: bool = False) -> dict[str, Any]:
        """Return the dotted keys and raw values of a case, perhaps with places for its numbers."""
        hollow = set(self.numbers.values()) if places else set()
        row = [Place(i) if i in hollow else c[case] for i, c in enumerate(self.columns)]
        return varied_keys(self.base, self._parts, row)

    def units(self) -> dict[str, str]:
        """Return the units of the varied keys under the laws of the cases, "" for none."""
        return {name: unit_under(name, self._laws) for name in self.names}

    def _laws(self, key: str) -> list[Any]:
        """Return the laws that the key of a law has in the cases."""
        base = value_of(self.base, key)
        if key not in self.names:
            return [base]
        laws = self.columns[self.names.index(key)].distinct
        return [base if law is None else law for law in laws]

    @cached_property
    def _parts(self) -> list[tuple[str, int | str | None]]:
        return [split_key(name) for name in self.names]

    @cached_property
    def kinds(self) -> IntArray:
        """(cases,) number of the kind that each case is of."""
        kinds = np.zeros(len(self), dtype=np.int64)
        for i, column in enumerate(self.columns):
            if i not in self.numbers.values():
                kinds = kinds * (int(column.codes.max(initial=0)) + 1) + column.codes
                kinds = np.unique(kinds, return_inverse=True)[1].astype(np.int64)
        return kinds

    def kind_words(self, case: int) -> str:
        """Return the values of a case that make its kind: all but the numbers."""
        numbers = self.numbers.values()
        return repr([column[case] for i, column in enumerate(self.columns) if i not in numbers])

    def inside(self) -> BoolArray:
        """Return in which cases all numbers are right by themselves."""
        good = np.ones(len(self), dtype=bool)
        for number, i in self.numbers.items():
            interval, values = interval_of(number), self.columns[i].numbers
            assert interval is not None
            assert values is not None
            good &= interval.holds(values)
        return good

    def floats(self, cases: IntArray) -> dict[Number, FloatArray]:
        """Return the numbers of some cases."""
        return {
            number: values[cases]
            for number, i in self.numbers.items()
            if (values := self.columns[i].numbers) is not None
        }


def by_kind(kinds: IntArray) -> Iterator[tuple[int, IntArray]]:
    """Yield each kind and its cases."""
    order = np.argsort(kinds, kind="stable")
    distinct, starts = np.unique(kinds[order], return_index=True)
    yield from zip(distinct.tolist(), np.split(order, starts)[1:], strict=True)


@dataclass(frozen=True, eq=False)
class Groups:
    """Groups of cases, in two arrays whatever their number; those of group g are ``groups[g]``."""

    #: numbers of the cases, group after group
    cases: IntArray
    #: (groups + 1,) where each begins
    starts: IntArray

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, group: int) -> IntArray:
        return self.cases[self.starts[group] : self.starts[group + 1]]

    def __iter__(self) -> Iterator[IntArray]:
        return (self[group] for group in range(len(self)))

    @property
    def sizes(self) -> IntArray:
        """Number of the cases of each group."""
        return np.diff(self.starts)

    def only(self, wanted: BoolArray) -> "Groups":
        """Return the groups with the wanted cases only, by number of the case."""
        chosen = wanted[self.cases]
        starts = np.concatenate([[0], np.cumsum(chosen)])[self.starts]
        return Groups(self.cases[chosen], starts)
