"""Studies: a base case and the columns of values that its cases have; cases are made when needed.

A study of a million cases is a few arrays. What many cases have in common is checked before any
work: the base case, and the ends of each varied key. A case whose values do not go together is
found when it is made, and fails alone.
"""

import hashlib
import itertools
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
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
from ringwear_par.cases.layers import LAYERS, entries_of
from ringwear_par.cases.numbers import Number, interval_of, needs_reading, with_numbers
from ringwear_par.cases.schema import BY_PATH, key_of, unit_under
from ringwear_par.errors import Fault, InputError
from ringwear_par.files.text import read_text, toml_text, toml_value
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.refusals.cases import check_memory, check_mesh
from ringwear_par.studies.definition.designs import read_draft
from ringwear_par.studies.definition.variations import (
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

    def digest(self, numbers: IntArray) -> str:
        """Return the name of some cases by their content and this version, 16 digits."""
        content = hashlib.sha256(self._common)
        for (path, _), column in zip(self._parts, self.columns, strict=True):
            part = column.part(numbers)
            if part.values.dtype == object:
                texts = part.by_case(partial(_raw_content, path))
                content.update("\0".join(texts).encode())
            else:
                content.update(part.values[part.codes].tobytes())
        return content.hexdigest()[:16]

    @cached_property
    def _common(self) -> bytes:
        """What all names depend on."""
        return json.dumps([__version__, _content(self.base), self.names]).encode()

    def ids(self, numbers: IntArray) -> Any:
        """Return the ids of some good cases, (len(numbers),) bytes of 16 digits each.

        An id is that of the content of a case, whatever study it is in, and however its keys are
        ordered or its numbers written.
        """
        ids = np.zeros(len(numbers), dtype="S16")
        plain = all(entry is None for _, entry in self._numbers)
        for places in self._alike(numbers):
            if not plain:
                contents = [_content(self.keys(int(numbers[place]))) for place in places]
                ids[places] = [_digest(content.values()) for content in contents]
                continue
            content: dict[str, Any] = dict(_content(self.keys(int(numbers[places[0]]))))
            for (path, _), i in self._numbers.items():
                part = self.columns[i].part(numbers[places])
                content[path] = part.by_case(partial(_number_content, path))
            texts = (
                itertools.repeat(text, len(places)) if isinstance(text, str) else text
                for _, text in sorted(content.items())
            )
            ids[places] = list(map(_digest, zip(*texts, strict=True)))
        return ids


def _digest(pairs: Iterable[str]) -> str:
    """Return the id of JSON pairs, "" for none."""
    return hashlib.sha256(f"{{{', '.join(filter(None, pairs))}}}".encode()).hexdigest()[:16]


def _content(keys: Mapping[str, Any]) -> dict[str, str]:
    """Return the JSON pair of each key of a case that its results depend on, sorted.

    Of the file of a law what it says, not where it is.
    """
    pairs: dict[str, str] = {}
    for path in sorted(keys.keys() - {"title"}):
        raw, key = keys[path], BY_PATH[path]
        if _is_law_file(path):
            pairs[path] = _pair(path, read_text(Path(raw)))
        elif path in LAYERS:
            for entry, value in sorted((entries_of(raw) or {}).items()):
                entry_key = key_of(f"{path}{entry}")
                assert entry_key is not None
                if (value := entry_key.read(value)) != entry_key.default:
                    pairs[f"{path}{entry}"] = _pair(f"{path}{entry}", value)
        elif (value := key.read(raw)) != key.default:
            pairs[path] = _pair(path, value)
    return pairs


def _is_law_file(path: str) -> bool:
    return path.startswith("wear.") and path.endswith(".file")


def _pair(path: str, value: Any) -> str:
    return f"{json.dumps(path)}: {json.dumps(value, default=repr)}"


def _number_content(path: str, raw: Any) -> str:
    """Return the JSON pair of a number, "" for the default of its key."""
    value = float(raw)
    return "" if value == BY_PATH[path].default else _pair(path, value)


def _raw_content(path: str, raw: Any) -> str:
    return read_text(Path(raw)) if _is_law_file(path) and raw is not None else toml_value(raw)


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
    draft = read_draft(source)
    study = Study(draft.name, draft.text, draft.method, draft.base, draft.names, draft.columns)
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
