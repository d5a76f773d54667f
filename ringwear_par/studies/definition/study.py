"""Studies: every case made once, checked, known by its content, and grouped by operator."""

import pickle
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.files.keys import naming
from ringwear_par.cases.files.law_trials import law_sources, refuse_bad_laws
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.numbers import needs_reading, with_numbers
from ringwear_par.cases.text import toml_value
from ringwear_par.elasticity.bem.boundary import count_elements
from ringwear_par.errors import InputError
from ringwear_par.history.elastic.bodies import operator_key, young
from ringwear_par.history.validity.case_limits import check_memory, check_mesh
from ringwear_par.studies.definition.bad_cases import LOOKED_AT, case_name, told_faults
from ringwear_par.studies.definition.designs import Draft, read_draft
from ringwear_par.studies.definition.groups import Groups
from ringwear_par.studies.definition.identities import identities_of
from ringwear_par.studies.definition.rows import Rows, by_kind
from ringwear_par.studies.definition.texts import Frame, Texts, joined

if TYPE_CHECKING:
    from mpi4py import MPI

#: most kinds of cases that a rank keeps at hand
_MOST_KINDS = 64


@dataclass(frozen=True)
class _Kind:
    """What the cases of a kind have in common: one of them, and the frame of their texts."""

    case: Case
    frame: Frame


@dataclass(frozen=True, eq=False)
class Study:
    """A study, complete: every case of it is known to be a good one.

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
    cases: Rows
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

    def __getstate__(self) -> dict[str, Any]:
        """Return what is sent to other ranks: nothing that is only at hand."""
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
        return tuple(zip(*(column.each() for column in self.cases.columns), strict=True))

    @cached_property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The members of the groups."""
        return tuple(tuple(group.tolist()) for group in self.members)

    def case(self, number: int) -> Case:
        """Return one case."""
        return self.made([number])[0][0]

    def keys(self, number: int) -> dict[str, Any]:
        """Return the dotted keys and raw values of one case."""
        return self.cases.keys(number)

    def made(self, numbers: Sequence[int] | IntArray) -> tuple[list[Case], Texts]:
        """Return some cases, and their texts by what they have in common."""
        numbers = np.asarray(numbers, dtype=np.int64)
        rows, kinds = self.cases.part(numbers), self.cases.kinds[numbers]
        written = {i: rows.columns[i].each(toml_value) for i in rows.numbers.values()}
        cases = np.empty(len(kinds), dtype=object)
        values = np.empty(len(kinds), dtype=object)
        frame_of = np.zeros(len(kinds), dtype=np.int64)
        frames: list[tuple[str, ...]] = []
        for kind, here in by_kind(kinds):
            own = self._kind(kind, int(numbers[here[0]]))
            places = here.tolist()
            columns = [[written[c][i] for i in places] for c in own.frame.columns]
            filled = list(zip(*columns, strict=True)) if columns else [()] * len(places)
            texts = [joined(own.frame.pieces, each) for each in filled]
            floats = {n: v.tolist() for n, v in self.cases.floats(numbers[here]).items()}
            made = with_numbers(own.case, floats, texts)
            for i, case, each in zip(places, made, filled, strict=True):
                cases[i], values[i] = case, each
            frame_of[here] = len(frames)
            frames.append(own.frame.pieces)
        return cases.tolist(), Texts(tuple(frames), tuple(frame_of.tolist()), tuple(values))

    def texts(self, numbers: Sequence[int] | IntArray) -> list[str]:
        """Return the texts of some cases."""
        return [case.text for case in self.made(numbers)[0]]

    def _kind(self, kind: int, number: int) -> _Kind:
        """Return the kind of a case, made of it if it is not at hand."""
        there = self._at_hand.pop(kind, None)
        if there is None:
            case = None
            if self.tried:
                tried = self.tried.get(self.cases.others(number))
                case = pickle.loads(tried) if tried is not None else None
            if case is None:
                case = make_case(self.cases.keys(number), self.name, text="")
            there = _Kind(case, Frame.of(self.cases.keys(number, places=True)))
            if len(self._at_hand) >= _MOST_KINDS:
                del self._at_hand[next(iter(self._at_hand))]
        self._at_hand[kind] = there
        return there

    @cached_property
    def _at_hand(self) -> dict[int, _Kind]:
        return {}


@dataclass
class _Checked:
    """What is known of a stretch of a draft's rows.

    Parameters
    ----------
    identities : (rows,) of the good cases.
    operators : (rows,) which of the keys of ``largest`` the operator of each depends on.
    moduli : (rows, 2) Young's moduli of lower and upper.
    work : (rows,) estimated seconds of stepping.
    largest : of the cases that share an operator, the one that stores most.
    operator_faults : what is wrong with the size or the mesh of each operator.
    tried : see Study.
    faults : of each of the first bad cases, with its number.
    bad : number of bad cases.
    """

    identities: Any
    operators: IntArray
    moduli: FloatArray
    work: FloatArray
    largest: dict[Hashable, Case]
    operator_faults: dict[Hashable, tuple[str, ...]]
    tried: dict[str, bytes]
    faults: list[tuple[int, tuple[str, ...]]]
    bad: int


def read_study(source: Path | str | Mapping[str, Any], ranks_per_case: int = 1) -> Study:
    """Read a study, its base case and its list, and check every case. Not collective.

    Parameters
    ----------
    source : name of the file, or its tables; files that these name are relative to the file, or to
        the present folder. In tables, ``case`` may be the tables of the base case itself.
    ranks_per_case : ranks that are to share a case.

    Raises
    ------
    InputError : all faults of the study together, or those of its first bad cases.
    """
    draft = read_draft(source)
    every = _Checker(draft, 0, draft.count, ranks_per_case).check()
    return _complete(draft, [every], ranks_per_case)


def read_study_together(
    source: Path | str | Mapping[str, Any], ranks_per_case: int, comm: "MPI.Intracomm"
) -> Study | None:
    """Read a study as ``read_study``, every rank checking its share of the cases.

    Collective on comm; returned on rank 0, None elsewhere.
    """
    from ringwear_par.parallel import on_first_rank, together

    draft = on_first_rank(comm, lambda: read_draft(source))
    first, last = (draft.count * i // comm.size for i in (comm.rank, comm.rank + 1))
    with together(comm):
        mine = _Checker(draft, first, last, ranks_per_case).check()
    stretches = comm.gather(mine)
    study = None
    with together(comm):
        if stretches is not None:
            study = _complete(draft, stretches, ranks_per_case)
    return study


class _Checker:
    """Checks the cases of a stretch of a draft: of each kind one, the others by their numbers."""

    def __init__(self, draft: Draft, first: int, last: int, ranks: int) -> None:
        self._draft, self._first, self._ranks = draft, first, ranks
        self.rows = Rows.of(draft).part(slice(first, last))
        self.count = last - first
        self.operators = np.zeros(self.count, dtype=np.int64)
        self.moduli, self.work = np.zeros((self.count, 2)), np.zeros(self.count)
        self.bad = np.zeros(self.count, dtype=bool)
        self.largest: dict[Hashable, Case] = {}
        self.operator_faults: dict[Hashable, tuple[str, ...]] = {}
        self.tried: dict[str, bytes] = {}
        #: a good case of each kind
        self.firsts: dict[int, int] = {}
        self._codes: dict[Hashable, int] = {}

    def check(self) -> _Checked:
        """Look at all of them."""
        inside = self.rows.inside()
        self.bad[~inside] = True
        for kind, here in by_kind(self.rows.kinds):
            self._check_kind(kind, here[inside[here]])
        faults = []
        for i in np.flatnonzero(self.bad)[:LOOKED_AT].tolist():
            try:
                self._alone(i)
            except InputError as error:
                faults.append((self._first + i + 1, error.faults))
        identities = np.zeros(0, dtype="S16")
        if not self.bad.any():
            identities = identities_of(self.rows, self.firsts)
        return _Checked(
            identities, self.operators, self.moduli, self.work, self.largest,
            self.operator_faults, self.tried, faults, int(self.bad.sum()),
        )  # fmt: skip

    def _check_kind(self, kind: int, here: IntArray) -> None:
        """Check the cases of a kind, whose numbers are right by themselves."""
        rest = here
        while len(rest):
            first, rest = int(rest[0]), rest[1:]
            try:
                case = self._alone(first)
            except InputError:
                self.bad[first] = True
                continue
            self._note(np.array([first]), case)
            self.firsts.setdefault(kind, first)
            if not self.rows.numbers:  # they are one case
                self._note(rest, case)
                return
            if len(rest):
                look = needs_reading(case, self.rows.floats(rest))
                self._note(rest[~look], case)
                rest = rest[look]
                if look.all():
                    break
        for i in rest.tolist():
            try:
                self._note(np.array([i]), self._alone(i))
            except InputError:
                self.bad[i] = True

    def _alone(self, i: int) -> Case:
        """Make and check one case.

        Raises
        ------
        InputError : its faults.
        """
        name = case_name(self._draft.name, self._first + i + 1)
        with naming(f"{name}:"):
            keys = self.rows.keys(i)
        case = make_case(keys, name, text="")
        refuse_bad_laws(case, name)
        return case

    def _note(self, here: IntArray, case: Case) -> None:
        """Note of good cases what one of them tells of all."""
        operator = operator_key(case)
        self.operators[here] = self._codes.setdefault(operator, len(self._codes))
        self.moduli[here] = young(case)
        for i, body in enumerate(("lower", "upper")):
            column = self.rows.numbers.get((f"{body}.young", None))
            if column is not None:
                values = self.rows.columns[column].numbers
                assert values is not None
                self.moduli[here, i] = values[here]
        self.work[here] = _stepping_work(case)
        there = self.largest.setdefault(operator, case)
        if there.stored_rows < case.stored_rows:
            self.largest[operator] = case
        if len(here) and law_sources(case):
            self.tried.setdefault(self.rows.others(int(here[0])), pickle.dumps(case))
        if operator not in self.operator_faults:
            try:
                check_memory(case, self._ranks, self._draft.name)  # first: a mesh takes memory too
                check_mesh(case, self._draft.name)
                self.operator_faults[operator] = ()
            except InputError as error:
                self.operator_faults[operator] = error.faults


def _complete(draft: Draft, stretches: Sequence[_Checked], ranks: int) -> Study:
    """Join stretches of checked rows: refuse bad ones, drop repetitions, and group by operator."""
    largest: dict[Hashable, Case] = {}
    operator_faults: dict[Hashable, tuple[str, ...]] = {}
    tried: dict[str, bytes] = {}
    codes: dict[Hashable, int] = {}
    operators = []
    for part in stretches:
        for operator, case in part.largest.items():
            there = largest.setdefault(operator, case)
            if there.stored_rows < case.stored_rows:
                largest[operator] = case
            codes.setdefault(operator, len(codes))
        operators.append([codes[operator] for operator in part.largest])
        operator_faults = {**part.operator_faults, **operator_faults}
        tried = {**part.tried, **tried}
    _refuse(draft, stretches, largest, operator_faults, ranks)
    identities = np.concatenate([part.identities for part in stretches])
    own = zip(operators, stretches, strict=True)
    operator_of = np.concatenate([np.array(o, dtype=np.int64)[p.operators] for o, p in own])
    moduli = np.concatenate([part.moduli for part in stretches])
    work = np.concatenate([part.work for part in stretches])
    rows = Rows.of(draft)
    firsts = np.unique(identities, return_index=True)[1]
    if len(firsts) < len(identities):  # some cases are there twice
        firsts.sort()
        rows, identities, operator_of = rows.part(firsts), identities[firsts], operator_of[firsts]
        moduli, work = moduli[firsts], work[firsts]
    assembly = np.array([_assembly_work(largest[operator]) for operator in codes])
    stepping = np.bincount(operator_of, work, len(codes))
    there, first_of = np.unique(operator_of, return_index=True)
    order = there[np.lexsort((first_of, -(assembly + stepping)[there]))]
    place = np.empty(len(codes), dtype=np.int64)
    place[order] = np.arange(len(order))
    members = np.lexsort((_first_of_its_moduli(moduli), place[operator_of]))
    sizes = np.bincount(place[operator_of], minlength=len(order))
    return Study(
        draft.name, draft.text, draft.method, rows, identities,
        Groups(members, np.concatenate([[0], np.cumsum(sizes)])), work, assembly[order], tried,
    )  # fmt: skip


def _first_of_its_moduli(moduli: FloatArray) -> IntArray:
    """Return for each row of moduli the first row that is the same."""
    pairs = np.ascontiguousarray(moduli).view(np.complex128)[:, 0]
    _, first, which = np.unique(pairs, return_index=True, return_inverse=True)
    return first[which]


def _refuse(
    draft: Draft,
    stretches: Sequence[_Checked],
    largest: Mapping[Hashable, Case],
    operator_faults: Mapping[Hashable, tuple[str, ...]],
    ranks: int,
) -> None:
    """Raise what is wrong with the cases of a study, if anything."""
    found = [one for part in stretches for one in part.faults][:LOOKED_AT]
    bad = sum(part.bad for part in stretches)
    faults = told_faults(draft.name, found, bad, draft.count)
    for operator, case in largest.items():
        try:
            check_memory(case, ranks, draft.name)
            own = operator_faults[operator]
        except InputError as error:
            own = error.faults
        faults += [fault for fault in own if fault not in faults]
    if faults:
        raise InputError(*faults)


def _stepping_work(case: Case) -> float:
    """Return about the seconds of a case's steps: a constant and the work on the matrix a step.

    Some ten times as many where elements follow the wear.
    """
    each = 1e-3 if case.follows_wear else 1e-4
    return each * case.about_steps * (1.0 + (case.mesh.contact_elements / 220.0) ** 2)


def _assembly_work(case: Case) -> float:
    """Return about the seconds of a case's boundary elements: n^2 assembly, n^3 factorisation."""
    rings = case.rings
    n = sum(count_elements(case.section(ring), case.contact, case.mesh) for ring in rings)
    return 0.04 * (n / 318.0) ** 2 + 0.006 * (n / 318.0) ** 3
