"""Checks of a study's cases: of each kind one is read, the others follow from its numbers.

A sentence on bad cases is said once, with the cases that it is about.
"""

import pickle
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.files.keys import naming
from ringwear_par.cases.files.law_trials import law_sources, refuse_bad_laws
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.numbers import needs_reading
from ringwear_par.errors import Fault, InputError
from ringwear_par.history.elastic.bodies import operator_key, young
from ringwear_par.history.refusals.cases import check_memory, check_mesh
from ringwear_par.studies.definition.designs import Draft
from ringwear_par.studies.definition.identities import identities_of
from ringwear_par.studies.definition.varied_columns import by_kind

#: most bad cases that are read again for their faults, and most whose own sentences are listed
LOOKED_AT, _LISTED = 200, 5
#: cases of a sentence that are named; one more is named too
_NAMED = 3


@dataclass
class CheckedCases:
    """A stretch of a draft's cases, checked."""

    #: (cases,) ids, none if any case is bad
    identities: Any
    #: (cases,) which of the keys of ``largest`` the operator of each depends on
    operators: IntArray
    #: (cases, 2) Young's moduli of lower and upper
    moduli: FloatArray
    #: (cases,) estimated seconds of stepping
    work: FloatArray
    #: of the cases that share an operator, the one that stores most
    largest: dict[Hashable, Case]
    #: faults in the size or the mesh of each operator
    operator_faults: dict[Hashable, tuple[str, ...]]
    #: a case of each kind that has a user's law, see ``Study``
    tried: dict[str, bytes]
    #: of each of the first bad cases, with its number
    faults: list[tuple[int, tuple[str, ...]]]
    #: number of bad cases
    bad: int


def check_cases(draft: Draft, first: int, last: int, ranks: int) -> CheckedCases:
    """Check the cases of a draft from ``first`` on, before ``last``; ranks share a case."""
    return _Checker(draft, first, last, ranks).check()


class _Checker:
    """Checks the cases of a stretch of a draft."""

    def __init__(self, draft: Draft, first: int, last: int, ranks: int) -> None:
        self._draft, self._first, self._ranks = draft, first, ranks
        self.rows, count = draft.cases.part(slice(first, last)), last - first
        self.checked = CheckedCases(
            np.zeros(0, dtype="S16"), np.zeros(count, dtype=np.int64), np.zeros((count, 2)),
            np.zeros(count), {}, {}, {}, [], 0,
        )  # fmt: skip
        self.bad = np.zeros(count, dtype=bool)
        #: a good case of each kind
        self.firsts: dict[int, int] = {}
        self._numbers: dict[Hashable, int] = {}

    def check(self) -> CheckedCases:
        """Return all of them, checked."""
        inside = self.rows.inside()
        self.bad[~inside] = True
        for kind, cases in by_kind(self.rows.kinds):
            self._check_kind(kind, cases[inside[cases]])
        checked = self.checked
        for i in np.flatnonzero(self.bad)[:LOOKED_AT].tolist():
            try:
                self._read(i)
            except InputError as error:
                checked.faults.append((self._first + i + 1, error.faults))
        checked.bad = int(self.bad.sum())
        if not checked.bad:
            checked.identities = identities_of(self.rows, self.firsts)
        return checked

    def _check_kind(self, kind: int, cases: IntArray) -> None:
        """Check the cases of a kind, whose numbers are right by themselves."""
        rest = cases
        while len(rest):
            first, rest = int(rest[0]), rest[1:]
            try:
                case = self._read(first)
            except InputError:
                self.bad[first] = True
                continue
            self._add(np.array([first]), case)
            self.firsts.setdefault(kind, first)
            if not self.rows.numbers:  # they are one case
                self._add(rest, case)
                return
            if len(rest):
                alone = needs_reading(case, self.rows.floats(rest))
                self._add(rest[~alone], case)
                rest = rest[alone]
                if alone.all():
                    break
        for i in rest.tolist():
            try:
                self._add(np.array([i]), self._read(i))
            except InputError:
                self.bad[i] = True

    def _read(self, i: int) -> Case:
        """Return one case, read and checked; InputError with its faults."""
        name = case_name(self._draft.name, self._first + i + 1)
        with naming(f"{name}:"):
            keys = self.rows.keys(i)
        case = make_case(keys, name, text="")
        refuse_bad_laws(case, name)
        return case

    def _add(self, cases: IntArray, case: Case) -> None:
        """Add good cases, which differ from one of them in numbers only."""
        checked, operator = self.checked, operator_key(case)
        checked.operators[cases] = self._numbers.setdefault(operator, len(self._numbers))
        checked.moduli[cases] = young(case)
        for i, body in enumerate(("lower", "upper")):
            column = self.rows.numbers.get((f"{body}.young", None))
            if column is not None:
                values = self.rows.columns[column].numbers
                assert values is not None
                checked.moduli[cases, i] = values[cases]
        checked.work[cases] = _stepping_work(case)
        add_larger(checked.largest, operator, case)
        if len(cases) and law_sources(case):
            checked.tried.setdefault(self.rows.kind_words(int(cases[0])), pickle.dumps(case))
        if operator not in checked.operator_faults:
            try:  # memory first: a mesh takes some too
                check_memory(case, self._ranks, self._draft.name)
                check_mesh(case, self._draft.name)
                checked.operator_faults[operator] = ()
            except InputError as error:
                checked.operator_faults[operator] = error.faults


def add_larger(largest: dict[Hashable, Case], operator: Hashable, case: Case) -> None:
    """Put a case among the largest ones by operator, if it is."""
    known = largest.setdefault(operator, case)
    if known.stored_rows < case.stored_rows:
        largest[operator] = case


def _stepping_work(case: Case) -> float:
    """Return about the seconds of a case's steps: a constant and the work on the matrix a step.

    Some ten times as many where elements follow the wear.
    """
    a_step = 1e-3 if case.follows_wear else 1e-4
    return a_step * case.about_steps * (1.0 + (case.mesh.contact_elements / 220.0) ** 2)


def refuse_bad_cases(
    draft: Draft, stretches: Sequence[CheckedCases], largest: Mapping[Hashable, Case], ranks: int
) -> None:
    """Refuse a study of bad cases: the faults of the first ones, and those of its operators.

    Of the cases of all stretches that share an operator, the largest stores most.
    """
    listed_faults = [fault for part in stretches for fault in part.faults][:LOOKED_AT]
    faults = case_faults(
        draft.name, listed_faults, sum(part.bad for part in stretches), len(draft.cases)
    )
    operator_faults: dict[Hashable, tuple[str, ...]] = {}
    for part in stretches:
        operator_faults = {**part.operator_faults, **operator_faults}
    for operator, case in largest.items():
        try:
            check_memory(case, ranks, draft.name)
            new_faults = operator_faults[operator]
        except InputError as error:
            new_faults = error.faults
        faults += [fault for fault in new_faults if fault not in faults]
    if faults:
        raise InputError(*faults)


def case_name(study: str, number: int) -> str:
    """Return the name of a case of a study in messages; the first one has number 1."""
    return f"{study}: case {number}"


def case_faults(
    study: str, first_bad: Sequence[tuple[int, Sequence[str]]], bad: int, count: int
) -> list[str]:
    """Return the faults of bad cases, each with its ``case_name``, and how many more there are."""
    cases_of: dict[str, list[int]] = {}
    first: dict[str, Fault] = {}  # of each sentence
    with_new = covered = 0
    for number, faults in first_bad:
        named = f"{case_name(study, number)}: "
        sentences = {fault.removeprefix(named): Fault(fault) for fault in faults}
        if not sentences.keys() <= cases_of.keys():
            if with_new == _LISTED:
                continue
            with_new += 1
        covered += 1
        first = sentences | first
        for sentence in sentences:
            cases_of.setdefault(sentence, []).append(number)
    lines: list[str] = [
        first[sentence].reworded(f"{study}: {_case_words(cases)}: {sentence}")
        for sentence, cases in cases_of.items()
    ]
    if bad > covered:
        lines.append(f"{study}: {bad - covered} more of {count} cases are bad")
    return lines


def _case_words(cases: Sequence[int]) -> str:
    """Return the names of cases, of the first of them where they are many."""
    if len(cases) == 1:
        return f"case {cases[0]}"
    many = len(cases) > _NAMED + 1
    named = cases[:_NAMED] if many else cases[:-1]
    last = f"{len(cases) - _NAMED} others" if many else str(cases[-1])
    return f"cases {', '.join(map(str, named))} and {last}"
