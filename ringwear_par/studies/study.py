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
from ringwear_par.cases.files.keys import naming, override
from ringwear_par.cases.files.law_trials import refuse_bad_laws
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.numbers import Number, cases_with, interval_of
from ringwear_par.cases.schema import unit_under
from ringwear_par.cases.values import is_number
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.files.text import read_text, toml_value
from ringwear_par.history.refusals import check_memory, check_mesh
from ringwear_par.studies.variations import cell, mapped, read_draft, split_key, value_of
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
        varied = ", ".join(self.columns)
        return f"<Study {self.name}: {self.method}, cases: {len(self)}, varied: {varied}>"

    def _repr_html_(self) -> str:
        """Return its varied keys and the rig of its first case, for notebooks."""
        units, table = self.units(), "<table><tr><th>key<th>values<th>unit"
        for name, column in self.columns.items():
            values = dict.fromkeys(f"{v:.4g}" if is_number(v) else str(v) for v in column.tolist())
            words = legible(", ".join(values), 100)
            table += f"<tr><td>{escape(name)}<td>{escape(words)}<td>{units[name]}"
        return f"<pre>{escape(repr(self))}</pre>{table}</table>{self.case(0)._repr_html_()}"

    def units(self) -> dict[str, str]:
        """Return the units of the varied keys under the laws of the cases, "" for none."""

        def laws(key: str) -> list[Any]:
            base = value_of(self.base, key)
            varied = dict.fromkeys(self.columns[key].tolist()) if key in self.columns else [base]
            return [base if law is None else law for law in varied]

        return {name: unit_under(name, laws) for name in self.columns}

    def stored(self, name: str) -> Any:
        """Return the values of a key as results have them: numbers or bytes."""
        if name in self._numeric:
            return self._numeric[name]
        return np.array([text.encode() for text in mapped(self.columns[name], cell)])

    # -- cases -------------------------------------------------------------------------------------

    def row(self, number: int) -> dict[str, Any]:
        """Return the raw values of the varied keys of a case, from 0 on."""
        return {name: column.item(number) for name, column in self.columns.items()}

    def case(self, number: int, text: str | None = None) -> Case:
        """Return a case, from 0 on; InputError for one that cannot be."""
        name = f"{self.name}: case {number + 1}"
        with naming(f"{name}:"):
            keys = override(self.base, self.row(number))
        case = make_case(keys, name, text)
        refuse_bad_laws(case, name)
        return case

    def case_or_error(self, number: int) -> Case | InputError:
        """Return a case without its text, or why it cannot be."""
        try:
            return self.case(number, text="")
        except InputError as error:
            return error

    def cases_of(self, numbers: IntArray) -> list[Case | InputError]:
        """Return some cases, without texts, or why one cannot be.

        Of cases that differ in numbers only, one is read, and the others are its copies.
        """
        cases = np.empty(len(numbers), dtype=object)
        kinds = self._kinds[numbers]
        for kind in np.unique(kinds):
            cases[kinds == kind] = self._alike(numbers[kinds == kind].tolist())
        return cases.tolist()

    def _alike(self, numbers: Sequence[int]) -> list[Case | InputError]:
        """Return cases that differ in numbers only."""
        first = self.case_or_error(numbers[0])
        if not self._numbers or isinstance(first, InputError):
            return [first, *map(self.case_or_error, numbers[1:])]
        values = {name: of[numbers] for name, of in self._numbers.items()}
        return cases_with(first, values, "", lambda place: self.case_or_error(numbers[place]))

    @cached_property
    def first(self) -> int:
        """The first case that can be, or 0 where none of many can."""
        some = range(min(len(self), _MOST_BAD))
        return next((n for n in some if isinstance(self.case_or_error(n), Case)), 0)

    # -- which cases are alike ---------------------------------------------------------------------

    @cached_property
    def _numeric(self) -> dict[str, FloatArray]:
        """The columns whose values are all numbers."""
        return {
            name: column.astype(float)
            for name, column in self.columns.items()
            if column.dtype == float or all(map(is_number, column))
        }

    @cached_property
    def _numbers(self) -> dict[Number, FloatArray]:
        """Columns of numbers: cases that differ in them only are copies of each other."""
        paths = {*self.base, *(split_key(name)[0] for name in self.columns)}
        numbers: dict[Number, FloatArray] = {}
        for name, column in self._numeric.items():
            path, entry = split_key(name)
            # no factor of the elasticity of a ring with layers
            layered = f"{path.removesuffix('young')}layers" in paths
            if not (isinstance(entry, int) or layered) and interval_of((path, entry)) is not None:
                numbers[path, entry] = column
        return numbers

    @cached_property
    def shapes(self) -> IntArray:
        """(cases,) equal numbers where cases have the same contact pair, from 0 on."""
        return self._codes(_SHAPE)

    @cached_property
    def _kinds(self) -> IntArray:
        """(cases,) equal numbers where cases differ in numbers only."""
        return self._codes("")

    @property
    def order(self) -> IntArray:
        """The cases by contact pair, then by what else is no number, else as in the design."""
        return np.lexsort((self._kinds, self.shapes))

    def _codes(self, starts: str | tuple[str, ...]) -> IntArray:
        """Return (cases,) equal numbers where keys that start so, and are no numbers, agree."""
        codes = np.zeros(len(self), dtype=np.int64)
        for name, column in self.columns.items():
            if name.startswith(starts) and split_key(name) not in self._numbers:
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

        def json_of(*content: Any) -> bytes:
            return json.dumps(content, default=repr).encode()

        base = {path: raw for path, raw in self.base.items() if path != "title"}
        common = hashlib.sha256(json_of(_content(base), tuple(self.columns)))
        columns = [
            mapped(column[numbers], partial(_content, path=split_key(name)[0]))
            for name, column in self.columns.items()
        ]
        ids = []
        for row in zip(*columns, strict=True):
            content = common.copy()
            content.update(json_of(*row))
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

    A value is bad if it is with those of the first case, and in the last case that has it. The
    first values of each key are looked at, or the least numbers, and the last.
    """
    case, row = study.case(study.first), study.row(study.first)
    check_memory(case, ranks, study.name)
    check_mesh(case, study.name)
    faults: list[Fault] = []
    for name, column in study.columns.items():
        first, codes = _distinct(column)
        every = range(len(first))
        for code in every if len(first) <= _MOST_VALUES else (0, len(first) - 1):
            number, last = int(first[code]), int(np.flatnonzero(codes == code)[-1])
            keys = override(study.base, row | {name: column.item(number)})
            try:
                make_case(keys, f"{study.name}: case {number + 1}", "")
            except InputError as error:
                if isinstance(study.case_or_error(last), InputError):
                    faults += error.faults
    if faults:
        raise InputError(*faults)
