"""Studies: a base case and the columns of values that its cases have; cases are made when needed.

A study of a million cases is a few arrays. What many cases have in common is checked before any
work: the base case, and the ends of each varied key. A case whose values do not go together is
found when it is made, and fails alone.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.files.keys import naming
from ringwear_par.cases.files.law_trials import refuse_bad_laws
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.numbers import Number, interval_of, needs_reading, with_numbers
from ringwear_par.cases.schema import unit_under
from ringwear_par.cases.values import is_number
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.files.text import read_text, toml_text, toml_value
from ringwear_par.history.refusals import check_memory, check_mesh
from ringwear_par.studies.variations import (
    cell,
    mapped,
    path_of,
    read_draft,
    split_key,
    value_of,
    varied_keys,
)
from ringwear_par.version import __version__

#: values of a key that are checked one by one; of more the least and the largest
_MOST_VALUES = 20
#: bad cases at the beginning of a design, after which no good one is looked for
_MOST_BAD = 100
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
    columns : raw values of the varied keys, (cases,) float64, or objects where not all are floats.
    ranges : "linear" or "log" and both ends, of keys that vary by ranges.
    """

    name: str
    text: str
    method: str
    base: Mapping[str, Any]
    columns: Mapping[str, NDArray[Any]]
    ranges: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def __repr__(self) -> str:
        varied = ", ".join(self.names)
        return f"<Study {self.name}: {self.method}, cases: {len(self)}, varied: {varied}>"

    def _repr_html_(self) -> str:
        """Return its varied keys and the rig of its first case, for notebooks."""
        units, table = self.units(), "<table><tr><th>key<th>values<th>unit"
        for name, column in self.columns.items():
            values = dict.fromkeys(f"{v:.4g}" if is_number(v) else str(v) for v in column.tolist())
            words = legible(", ".join(values), 100)
            table += f"<tr><td>{escape(name)}<td>{escape(words)}<td>{units[name]}"
        return f"<pre>{escape(repr(self))}</pre>{table}</table>{self.case(0)._repr_html_()}"

    @property
    def names(self) -> tuple[str, ...]:
        """The varied keys."""
        return tuple(self.columns)

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
        laws = dict.fromkeys(self.columns[key].tolist()) if key in self.columns else (base,)
        return [base if law is None else law for law in laws]

    def stored(self, name: str) -> Any:
        """Return the values of a key as results have them: numbers or bytes."""
        if name in self._numeric:
            return self._numeric[name]
        return np.array([text.encode() for text in mapped(self.columns[name], cell)])

    @cached_property
    def _numeric(self) -> dict[str, FloatArray]:
        """The columns whose values are all numbers."""
        return {
            name: column.astype(float)
            for name, column in self.columns.items()
            if column.dtype == float or all(map(is_number, column))
        }

    # -- cases -------------------------------------------------------------------------------------

    def keys(self, number: int) -> dict[str, Any]:
        """Return the dotted keys and raw values of a case, from 0 on."""
        return self.keys_of([column[number] for column in self.columns.values()])

    def keys_of(self, row: Sequence[Any]) -> dict[str, Any]:
        """Return the keys of a case with a row of values."""
        values = [float(value) if isinstance(value, np.float64) else value for value in row]
        return varied_keys(self.base, self.names, values)

    def case(self, number: int, text: str | None = None) -> Case:
        """Return a case, from 0 on; InputError for one that cannot be."""
        name = f"{self.name}: case {number + 1}"
        with naming(f"{name}:"):
            keys = self.keys(number)
        case = make_case(keys, name, text)
        refuse_bad_laws(case, name)
        return case

    def case_or_error(self, number: int) -> Case | InputError:
        """Return a case without its text, or why it cannot be."""
        try:
            return self.case(number, text="")
        except InputError as error:
            return error

    @cached_property
    def first(self) -> int:
        """The first case that can be, or 0 where none of many can."""
        for number in range(min(len(self), _MOST_BAD)):
            if isinstance(self.case_or_error(number), Case):
                return number
        return 0

    @cached_property
    def _parts(self) -> list[tuple[str, int | str | None]]:
        return [split_key(name) for name in self.names]

    @cached_property
    def _numbers(self) -> dict[Number, FloatArray]:
        """Columns of numbers: cases that differ in them only are copies of each other."""
        paths = {*self.base, *map(path_of, self.names)}
        numbers: dict[Number, FloatArray] = {}
        for name, (path, entry) in zip(self.names, self._parts, strict=True):
            # no factor of the elasticity of a ring with layers
            layered = f"{path.removesuffix('young')}layers" in paths
            number = None if isinstance(entry, int) or layered else (path, entry)
            if name in self._numeric and number and interval_of(number) is not None:
                numbers[number] = self._numeric[name]
        return numbers

    def cases_of(self, numbers: IntArray) -> list[Case | InputError]:
        """Return some cases, without texts, or why one cannot be."""
        cases = np.empty(len(numbers), dtype=object)
        kinds = self._kinds[numbers]
        for kind in np.unique(kinds):
            cases[kinds == kind] = self._alike(numbers[kinds == kind])
        return cases.tolist()

    def _alike(self, numbers: IntArray) -> list[Case | InputError]:
        """Return cases that differ in numbers only: one is read, the others are its copies."""
        pattern = self.case_or_error(int(numbers[0]))
        if isinstance(pattern, InputError) or not self._numbers:
            return [pattern, *map(self.case_or_error, numbers[1:].tolist())]
        values = {name: column[numbers] for name, column in self._numbers.items()}
        columns = {name: column.tolist() for name, column in values.items()}
        cases: list[Case | InputError] = [*with_numbers(pattern, columns, [""] * len(numbers))]
        for place in np.flatnonzero(needs_reading(pattern, values)):
            cases[place] = self.case_or_error(int(numbers[place]))
        return cases

    # -- their order ---------------------------------------------------------------------------

    @cached_property
    def shapes(self) -> IntArray:
        """(cases,) equal numbers where cases have the same contact pair, from 0 on."""
        return self._codes(_SHAPE)

    @cached_property
    def _kinds(self) -> IntArray:
        """(cases,) equal numbers where cases differ in numbers only."""
        return self._codes("")

    @cached_property
    def order(self) -> IntArray:
        """The cases by contact pair, then by what else is no number, else as in the design."""
        return np.lexsort((self._kinds, self.shapes))

    def _codes(self, starts: str | tuple[str, ...]) -> IntArray:
        """Return (cases,) equal numbers where keys that start so, and are no numbers, agree."""
        codes = np.zeros(len(self), dtype=np.int64)
        for part, column in zip(self._parts, self.columns.values(), strict=True):
            if part[0].startswith(starts) and part not in self._numbers:
                first, own = _distinct(column)
                codes = codes * len(first) + own
                codes = np.unique(codes, return_inverse=True)[1].astype(np.int64)
        return codes

    # -- names by content --------------------------------------------------------------------------

    def ids(self, numbers: IntArray) -> Any:
        """Return the ids of some cases, (len(numbers),) bytes of 16 digits each.

        An id is that of the content of a case, however its numbers are written: of the base case,
        what varies, its values, and the text of laws that are files.
        """
        base = {path: raw for path, raw in self.base.items() if path != "title"}
        common = hashlib.sha256(_json(_content(base), self.names))
        columns = [
            mapped(column[numbers], partial(_content, path=path))
            for (path, _), column in zip(self._parts, self.columns.values(), strict=True)
        ]
        ids = []
        for row in zip(*columns, strict=True):
            content = common.copy()
            content.update(_json(*row))
            ids.append(content.hexdigest()[:16])
        return np.array(ids, dtype="S16")

    def digest(self, numbers: IntArray) -> str:
        """Return the name of some cases by their contents and this version, 16 digits."""
        return hashlib.sha256(__version__.encode() + self.ids(numbers).tobytes()).hexdigest()[:16]


def _distinct(column: NDArray[Any]) -> tuple[IntArray, IntArray]:
    """Return where each value is first, and which each case has: numbers in order, or by place."""
    if column.dtype == object:
        texts = mapped(column, toml_value)
        codes = {text: code for code, text in enumerate(dict.fromkeys(texts))}
        column = np.array([codes[text] for text in texts])
    return np.unique(column, return_index=True, return_inverse=True)[1:]


def _json(*content: Any) -> bytes:
    return json.dumps(content, default=repr).encode()


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
    study = Study(**read_draft(source))
    _check(study, ranks_per_case)
    return study


def _check(study: Study, ranks: int) -> None:
    """Refuse a study whose base is bad, or a value of a key whatever the others are.

    A value is bad if it is with those of the first case, and in the last case that has it.
    """
    case = study.case(study.first)
    check_memory(case, ranks, study.name)
    check_mesh(case, study.name)
    row, faults = [column[study.first] for column in study.columns.values()], list[Fault]()
    for i, column in enumerate(study.columns.values()):
        first, codes = _distinct(column)
        ends = range(len(first))[: _MOST_VALUES if column.dtype == object else None]
        if len(ends) > _MOST_VALUES:  # the least and the largest number
            ends = ends[:: len(ends) - 1]
        for end in ends:
            keys = study.keys_of([*row[:i], column[first[end]], *row[i + 1 :]])
            try:
                make_case(keys, f"{study.name}: case {first[end] + 1}", "")
            except InputError as error:
                last = int(np.flatnonzero(codes == end)[-1])
                if isinstance(study.case_or_error(last), InputError):
                    faults += error.faults
    if faults:
        raise InputError(*faults)
