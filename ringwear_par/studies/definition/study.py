"""Studies: every case made once, checked, known by its content, and grouped by operator."""

import logging
import pickle
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.numbers import with_numbers
from ringwear_par.elasticity.bem.boundary import count_elements
from ringwear_par.files.text import toml_value
from ringwear_par.studies.definition.checking import (
    CheckedCases,
    add_larger,
    check_cases,
    refuse_bad_cases,
)
from ringwear_par.studies.definition.designs import Draft, read_draft
from ringwear_par.studies.definition.varied_columns import CaseColumns, Frame, Groups, by_kind

if TYPE_CHECKING:
    from mpi4py import MPI

log = logging.getLogger(__name__)

#: most kinds of cases that a rank keeps in memory
_MOST_KINDS = 64


@dataclass(frozen=True)
class _Kind:
    """A case of a kind, of which the others are copies with other numbers, and their template."""

    case: Case
    frame: Frame


@dataclass(frozen=True, eq=False)
class Study:
    """A study, complete, whose cases have all been checked.

    Parameters
    ----------
    name, text, method : as in its Draft.
    cases : by column; no case is there twice.
    identities : (cases,) bytes, one id a case.
    members : numbers of the cases that share an operator, longest work first; those of the same
        moduli follow each other.
    work : estimated seconds of stepping of each case, (cases,).
    assembly : estimated seconds of assembly of each group, (groups,). Both are in proportion only.
    tried : a case of each kind that has a user's law, as it was read and tried: its file may
        change, or be on another machine.
    """

    name: str
    text: str
    method: str
    cases: CaseColumns
    identities: Any
    members: Groups
    work: FloatArray
    assembly: FloatArray
    tried: Mapping[str, bytes]

    def __repr__(self) -> str:
        return (
            f"<Study {self.name}: {self.method}, cases: {len(self.identities)}, operators: "
            f"{len(self.members)}, varied: {', '.join(self.names) or 'nothing'}>"
        )

    def _repr_html_(self) -> str:
        """Return its varied keys and the rig of its first case, for notebooks."""
        # pages stand on studies, which know nothing else of them
        return str(import_module("ringwear_par.reports.notebook").study_html(self))

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields, without kinds at hand, which other ranks do not need."""
        return {k: v for k, v in self.__dict__.items() if k in self.__dataclass_fields__}

    @property
    def names(self) -> tuple[str, ...]:
        """The varied keys."""
        return self.cases.names

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """One id a case."""
        return tuple(self.identities.astype(str).tolist())

    @cached_property
    def rows(self) -> tuple[tuple[Any, ...], ...]:
        """Raw values of each case, in the order of ``names``."""
        return tuple(zip(*(column.by_case() for column in self.cases.columns), strict=True))

    @cached_property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The members of the groups."""
        return tuple(tuple(group.tolist()) for group in self.members)

    def case(self, number: int) -> Case:
        """Return one case."""
        return self.cases_of([number])[0]

    def keys(self, number: int) -> dict[str, Any]:
        """Return the dotted keys and raw values of one case."""
        return self.cases.keys(number)

    def cases_of(self, numbers: Sequence[int] | IntArray) -> list[Case]:
        """Return some cases, with their texts."""
        numbers = np.asarray(numbers, dtype=np.int64)
        rows, kinds = self.cases.part(numbers), self.cases.kinds[numbers]
        written = {i: rows.columns[i].by_case(toml_value) for i in rows.numbers.values()}
        cases = np.empty(len(kinds), dtype=object)
        for number, members in by_kind(kinds):
            kind = self._kind(number, int(numbers[members[0]]))
            places = members.tolist()
            columns = [[written[c][i] for i in places] for c in kind.frame.columns]
            filled = list(zip(*columns, strict=True)) if columns else [()] * len(places)
            texts = list(map(kind.frame.filled, filled))
            floats = {n: v.tolist() for n, v in self.cases.floats(numbers[members]).items()}
            for i, case in zip(places, with_numbers(kind.case, floats, texts), strict=True):
                cases[i] = case
        return cases.tolist()

    def texts(self, numbers: Sequence[int] | IntArray) -> list[str]:
        """Return the texts of some cases."""
        return [case.text for case in self.cases_of(numbers)]

    def _kind(self, kind: int, number: int) -> _Kind:
        """Return the kind of a case, made of it if it is not at hand."""
        known = self._at_hand.pop(kind, None)
        if known is None:
            tried = self.tried.get(self.cases.kind_words(number)) if self.tried else None
            case = pickle.loads(tried) if tried is not None else None
            if case is None:
                case = make_case(self.cases.keys(number), self.name, text="")
            known = _Kind(case, Frame.of(self.cases.keys(number, places=True)))
            if len(self._at_hand) >= _MOST_KINDS:
                del self._at_hand[next(iter(self._at_hand))]
        self._at_hand[kind] = known
        return known

    @cached_property
    def _at_hand(self) -> dict[int, _Kind]:
        return {}


def read_study(source: Path | str | Mapping[str, Any], ranks_per_case: int = 1) -> Study:
    """Read a study, its base case and its list, and check every case. Not collective.

    Parameters
    ----------
    source : name of the file, or its tables; files that these name are relative to the file, or to
        the present folder. In tables, ``case`` may be the tables of the base case itself.
    ranks_per_case : ranks that are to share a case.

    Returns
    -------
    Study : with ``.keys`` that vary and ``.cases``, for ``sweep``.

    Raises
    ------
    InputError : all faults of the study together, or those of its first bad cases.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> study = rw.read_study("scripts/cases/study.toml")
    >>> len(study.cases)
    45
    """
    draft = read_draft(source)
    return _complete(
        draft, [check_cases(draft, 0, len(draft.cases), ranks_per_case)], ranks_per_case
    )


def read_study_together(
    source: Path | str | Mapping[str, Any], ranks_per_case: int, comm: "MPI.Intracomm"
) -> Study | None:
    """Read a study as ``read_study``, every rank checking its share of the cases.

    Collective on comm; returned on rank 0, None elsewhere.
    """
    from ringwear_par.parallel import on_first_rank, together

    draft = on_first_rank(comm, lambda: read_draft(source))
    first, last = (len(draft.cases) * i // comm.size for i in (comm.rank, comm.rank + 1))
    with together(comm):
        stretch = check_cases(draft, first, last, ranks_per_case)
    stretches = comm.gather(stretch)
    study = None
    with together(comm):
        if stretches is not None:
            study = _complete(draft, stretches, ranks_per_case)
    return study


def _complete(draft: Draft, stretches: Sequence[CheckedCases], ranks: int) -> Study:
    """Join stretches of checked cases: refuse bad ones, drop repetitions, group by operator."""
    largest: dict[Hashable, Case] = {}
    for part in stretches:
        for operator, case in part.largest.items():
            add_larger(largest, operator, case)
    refuse_bad_cases(draft, stretches, largest, ranks)
    number_of = {operator: number for number, operator in enumerate(largest)}
    operators = np.concatenate([
        np.array([number_of[operator] for operator in part.largest], dtype=np.int64)[part.operators]
        for part in stretches
    ])  # fmt: skip
    identities = np.concatenate([part.identities for part in stretches])
    moduli = np.concatenate([part.moduli for part in stretches])
    work = np.concatenate([part.work for part in stretches])
    cases = draft.cases
    firsts = np.sort(np.unique(identities, return_index=True)[1])
    if len(firsts) < len(identities):  # some cases are there twice
        log.warning(
            "%s: cases that are there twice, and are computed once: %d of %d",
            draft.name, len(identities) - len(firsts), len(identities),
        )  # fmt: skip
        cases, identities, operators = cases.part(firsts), identities[firsts], operators[firsts]
        moduli, work = moduli[firsts], work[firsts]
    assembly = np.array([_assembly_work(case) for case in largest.values()])
    stepping = np.bincount(operators, work, len(largest))
    used, first_of = np.unique(operators, return_index=True)
    order = used[np.lexsort((first_of, -(assembly + stepping)[used]))]
    place = np.empty(len(largest), dtype=np.int64)
    place[order] = np.arange(len(order))
    members = np.lexsort((_first_of_its_moduli(moduli), place[operators]))
    sizes = np.bincount(place[operators], minlength=len(order))
    tried = {kind: case for part in reversed(stretches) for kind, case in part.tried.items()}
    return Study(
        draft.name, draft.text, draft.method, cases, identities,
        Groups(members, np.concatenate([[0], np.cumsum(sizes)])), work, assembly[order], tried,
    )  # fmt: skip


def _first_of_its_moduli(moduli: FloatArray) -> IntArray:
    """Return for each row of moduli the first row that is the same."""
    pairs = np.ascontiguousarray(moduli).view(np.complex128)[:, 0]
    _, first, which = np.unique(pairs, return_index=True, return_inverse=True)
    return first[which]


def _assembly_work(case: Case) -> float:
    """Return about the seconds of a case's boundary elements: n^2 assembly, n^3 factorisation."""
    rings = case.rings
    n = sum(count_elements(case.section(ring), case.contact, case.mesh) for ring in rings)
    return 0.04 * (n / 318.0) ** 2 + 0.006 * (n / 318.0) ** 3
