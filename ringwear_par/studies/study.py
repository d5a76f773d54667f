"""Studies: a base case and the columns of values that its cases have; cases are made when needed.

A study of a million cases is a few arrays. What many cases have in common is checked before any
work: the base case, and the ends of each varied key. A case whose values do not go together is
found when it is made, and fails alone.
"""

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.files.keys import naming
from ringwear_par.cases.files.law_trials import refuse_bad_laws
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.numbers import Number, interval_of, needs_reading, with_numbers
from ringwear_par.cases.schema import unit_under
from ringwear_par.cases.values import is_number
from ringwear_par.errors import Fault, InputError
from ringwear_par.files.text import read_text, toml_text
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.refusals.cases import check_memory, check_mesh
from ringwear_par.studies.designs import read_draft
from ringwear_par.studies.variations import (
    Column,
    path_of,
    split_key,
    value_of,
    varied_keys,
)
from ringwear_par.version import __version__

#: values of a key that are checked one by one; of more the least and the largest
_MOST_VALUES = 20
#: cases that are tried for a good one, in all and with a value of a key
_TRIED, _TRIED_OF_VALUE = 16, 4
#: keys of these parts of a case decide which contact pair it has
_SHAPE = ("lower", "upper", "mesh")


@dataclass(frozen=True, eq=False)
class Study:
    """A study whose base case and values have been checked, see ``read_study``.

    Parameters
    ----------
    name : what messages call it.
    text : its TOML text.
    method : of the design.
    base : dotted keys and raw values of the base case.
    names : the varied keys.
    columns : their raw values in all cases, in the order of ``names``.
    """

    name: str
    text: str
    method: str
    base: Mapping[str, Any]
    names: tuple[str, ...]
    columns: tuple[Column, ...]

    def __len__(self) -> int:
        return len(self.columns[0])

    def __repr__(self) -> str:
        varied = ", ".join(self.names)
        return f"<Study {self.name}: {self.method}, cases: {len(self)}, varied: {varied}>"

    def _repr_html_(self) -> str:
        """Return its varied keys and the rig of its first case, for notebooks."""
        # pages stand on studies, which know nothing else of them
        return str(import_module("ringwear_par.reports.notebook").study_html(self))

    @property
    def base_text(self) -> str:
        """The base case as TOML."""
        return toml_text(self.base)

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

    # -- single cases ------------------------------------------------------------------------------

    def keys(self, number: int) -> dict[str, Any]:
        """Return the dotted keys and raw values of a case, from 0 on."""
        return self._keys([column[number] for column in self.columns])

    def _keys(self, row: Sequence[Any]) -> dict[str, Any]:
        """Return the keys of a case with a row of values."""
        return varied_keys(self.base, self._parts, row)

    def case(self, number: int) -> Case:
        """Return a case, from 0 on; InputError for one that cannot be."""
        return self._made(number)

    def a_case(self) -> Case:
        """Return the first case that can be, of some of them."""
        made = map(self._case_or_error, _spread(len(self)))
        return next(case for case in made if isinstance(case, Case))

    def _made(self, number: int, text: str | None = None) -> Case:
        name = f"{self.name}: case {number + 1}"
        with naming(f"{name}:"):
            keys = self.keys(number)
        case = make_case(keys, name, text)
        refuse_bad_laws(case, name)
        return case

    @cached_property
    def _parts(self) -> list[tuple[str, int | str | None]]:
        return [split_key(name) for name in self.names]

    # -- many cases --------------------------------------------------------------------------------

    @cached_property
    def _numbers(self) -> dict[Number, int]:
        """Columns of numbers: cases that differ in them only are copies of each other."""
        numbers: dict[Number, int] = {}
        paths = {*self.base, *map(path_of, self.names)}
        for i, (path, entry) in enumerate(self._parts):
            body, _, name = path.partition(".")
            layered = name == "young" and f"{body}.layers" in paths  # no factor of the elasticity
            if isinstance(entry, int) or self.columns[i].numbers is None or layered:
                continue
            if interval_of((path, entry)) is not None:
                numbers[path, entry] = i
        return numbers

    @cached_property
    def _others(self) -> list[int]:
        """The other columns."""
        return [i for i in range(len(self.columns)) if i not in self._numbers.values()]

    def _alike(self, numbers: IntArray) -> Iterator[IntArray]:
        """Yield the places of cases that differ in numbers only."""
        groups: dict[tuple[int, ...], list[int]] = {}
        codes = [self.columns[i].codes[numbers].tolist() for i in self._others]
        rows: Iterable[tuple[int, ...]] = zip(*codes, strict=True) if codes else [()] * len(numbers)
        for place, row in enumerate(rows):
            groups.setdefault(row, []).append(place)
        yield from map(np.array, groups.values())

    def cases_of(self, numbers: IntArray) -> list[Case | InputError]:
        """Return some cases, without texts, or why one cannot be.

        Of cases that differ in numbers only one is read, the others are its copies.
        """
        cases = np.empty(len(numbers), dtype=object)
        for places in self._alike(numbers):
            while len(places):
                first, places = places[0], places[1:]
                cases[first] = pattern = self._case_or_error(int(numbers[first]))
                if isinstance(pattern, Case) and len(places):
                    values = {
                        number: column[numbers[places]]
                        for number, i in self._numbers.items()
                        if (column := self.columns[i].numbers) is not None
                    }
                    alone = np.zeros(len(places), dtype=bool)
                    for number, column in values.items():
                        interval = interval_of(number)
                        assert interval is not None
                        alone |= ~interval.holds(column)
                    alone |= needs_reading(pattern, values) if values else False
                    floats = {number: column[~alone].tolist() for number, column in values.items()}
                    copies = places[~alone]
                    cases[copies] = with_numbers(pattern, floats, [""] * len(copies))
                    for place in places[alone]:
                        cases[place] = self._case_or_error(int(numbers[place]))
                    break
        return cases.tolist()

    def _case_or_error(self, number: int) -> Case | InputError:
        try:
            return self._made(number, text="")
        except InputError as error:
            return error

    @cached_property
    def shapes(self) -> IntArray:
        """(cases,) equal numbers where cases have the same contact pair, from 0 on."""
        return self._codes([i for i in self._others if self._parts[i][0].startswith(_SHAPE)])

    @cached_property
    def order(self) -> IntArray:
        """The cases by contact pair, then by what else is no number, else as in the design."""
        if not self._others:
            return np.arange(len(self))
        return np.lexsort((self._codes(self._others), self.shapes))

    def _codes(self, columns: Sequence[int]) -> IntArray:
        codes = np.zeros(len(self), dtype=np.int64)
        for column in (self.columns[i] for i in columns):
            codes = codes * (int(column.codes.max()) + 1) + column.codes
            codes = np.unique(codes, return_inverse=True)[1].astype(np.int64)
        return codes

    # -- names by content --------------------------------------------------------------------------

    def ids(self, numbers: IntArray) -> Any:
        """Return the ids of some cases, (len(numbers),) bytes of 16 digits each.

        An id is that of the content of a case, however its numbers are written: of the base case,
        what varies, its values, and the text of laws that are files.
        """
        columns = [
            column.part(numbers).by_case(partial(_text_of, path))
            for (path, _), column in zip(self._parts, self.columns, strict=True)
        ]
        ids = []
        for row in map("\0".join, zip(*columns, strict=True)):
            content = self._common.copy()
            content.update(row.encode())
            ids.append(content.hexdigest()[:16])
        return np.array(ids, dtype="S16")

    @cached_property
    def _common(self) -> Any:
        """The hash of what all cases have."""
        base = {path: raw for path, raw in self.base.items() if path != "title"}
        return hashlib.sha256(json.dumps([_content(base), self.names], default=repr).encode())

    def digest(self, numbers: IntArray) -> str:
        """Return the name of some cases by their contents and this version, 16 digits."""
        return hashlib.sha256(__version__.encode() + self.ids(numbers).tobytes()).hexdigest()[:16]

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields, for other ranks."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def _text_of(path: str, raw: Any) -> str:
    """Return the content of a key as a text."""
    return repr(raw) if type(raw) is float else json.dumps(_content(raw, path), default=repr)


def _content(raw: Any, path: str = "") -> Any:
    """Return a raw value as JSON has it, of the file of a law what it says."""
    if isinstance(raw, Mapping):
        return {name: _content(value, name) for name, value in sorted(raw.items())}
    if isinstance(raw, list | tuple):
        return [_content(value) for value in raw]
    if isinstance(raw, str) and path.rpartition(".")[2] == "file":
        return read_text(Path(raw))
    return float(raw) if is_number(raw) else raw


# -- reading -----------------------------------------------------------------------------------


def read_study(source: Path | str | Mapping[str, Any], ranks_per_case: int = 1) -> Study:
    """Read a study, its base case and its list; check the base and the ends of each varied key.

    Parameters
    ----------
    source : name of the file, or its tables; files that these name are relative to the file, or to
        the present folder. In tables, ``case`` may be the tables of the base case itself.
    ranks_per_case : ranks that are to share a case.

    Returns
    -------
    Study : for ``sweep``; ``len(study)`` cases, of which ``study.case(i)`` makes one.

    Raises
    ------
    InputError : all faults of the study together, or those of its values. A case whose values do
        not go together, each being right by itself, fails when the sweep comes to it.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> study = rw.read_study("scripts/cases/study.toml")
    >>> len(study)
    45
    """
    study = Study(*read_draft(source))
    _check(study, ranks_per_case)
    return study


def _check(study: Study, ranks: int) -> None:
    """Refuse a study whose base is bad, or a value of a key whatever the others are."""
    faults: dict[str, Fault] = {}
    operators = set()

    def is_good(make: Callable[[], Case]) -> bool:
        try:
            case = make()
            check_memory(case, ranks, study.name)
            if (operator := operator_key(case)) not in operators:
                check_mesh(case, study.name)
                operators.add(operator)
        except InputError as error:
            for fault in map(Fault, error.faults):  # of several cases the same one once
                faults.setdefault(re.sub(r": case \d+", "", fault), fault)
            return False
        return True

    first = next((n for n in _spread(len(study)) if is_good(partial(study.case, n))), None)
    if first is None:
        raise InputError(*faults.values())
    faults.clear()
    row = [column[first] for column in study.columns]
    bad: dict[str, Fault] = {}
    for i, column in enumerate(study.columns):
        for number in _ends(column):
            same = np.flatnonzero(column.codes == column.codes[number])
            few = same[np.linspace(0, len(same) - 1, _TRIED_OF_VALUE).astype(int)]
            makes = [partial(study.case, n) for n in np.unique([number, *few]).tolist()]
            changed = study._keys([*row[:i], column[number], *row[i + 1 :]])
            makes.append(partial(make_case, changed, study.name, ""))
            if not any(map(is_good, makes)):
                bad |= faults
            faults.clear()
    if bad:
        raise InputError(*bad.values())


def _spread(count: int) -> list[int]:
    """Return numbers of some of so many cases, from the first to the last."""
    return np.unique(np.linspace(0, count - 1, _TRIED).astype(int)).tolist()


def _ends(column: Column) -> list[int]:
    """Return numbers of cases that have the values of a column, or the least and the largest."""
    _, first = np.unique(column.codes, return_index=True)
    if len(first) <= _MOST_VALUES:
        return np.sort(first).tolist()
    if column.numbers is None:
        return np.sort(first)[:_MOST_VALUES].tolist()
    return [int(column.numbers.argmin()), int(column.numbers.argmax())]
