"""Studies: every case made once, checked, known by its content, and grouped by operator.

A case is known by its content: its id does not depend on the study it belongs to, on the order of
its keys or on how a number is written, so that a study may grow, shrink or change and the cases
that stay the same keep their results.
"""

import hashlib
import json
import pickle
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.law_trials import refuse_bad_laws
from ringwear_par.cases.reading import make_case
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.text import toml_text
from ringwear_par.elasticity.mesh import count_elements
from ringwear_par.errors import InputError
from ringwear_par.history.bodies import operator_key
from ringwear_par.history.limits import check_memory, check_mesh, check_ranks
from ringwear_par.studies.designs import Draft, read_draft
from ringwear_par.studies.variations import split_key, varied_keys
from ringwear_par.textfiles import read_text

if TYPE_CHECKING:
    from mpi4py import MPI

#: defaults of before keys had to be given: the ids of the cases of then have to stay
_NOT_IN_IDS = {f"wear.{body}.law": "threshold" for body in ("lower", "upper")}
#: faults of single cases told one by one; the rest are counted
_FAULTS_TOLD = 5


@dataclass(frozen=True)
class Study:
    """A study, complete: every case of it is known to be a good one.

    Parameters
    ----------
    name, text, base, names, method, rows : as in its Draft; no case is there twice.
    ids : one id a case.
    pickled : one case each as it was made and checked, without its text; a tenth of the time of
        making it anew, a fifth of the memory of the object, and sent to other ranks as it is.
    groups : indices of the cases that share an operator, longest work first; those of the same
        moduli follow each other.
    work : estimated seconds of stepping of each case, (cases,).
    assembly : estimated seconds of assembly of each group, (groups,). Both are in proportion only.
    """

    name: str
    text: str
    base: Mapping[str, Any]
    names: tuple[str, ...]
    method: str
    rows: tuple[tuple[Any, ...], ...]
    ids: tuple[str, ...]
    pickled: tuple[bytes, ...]
    groups: tuple[tuple[int, ...], ...]
    work: FloatArray
    assembly: FloatArray

    def __repr__(self) -> str:
        return (
            f"<Study {self.name}: {self.method}, cases: {len(self.ids)}, operators: "
            f"{len(self.groups)}, varied: {', '.join(self.names) or 'nothing'}>"
        )

    def case(self, number: int) -> Case:
        """Return one case."""
        case: Case = pickle.loads(self.pickled[number])
        # nobody else has this one yet; dataclasses.replace would lose what makes a text change it
        object.__setattr__(case, "text", toml_text(self.keys(number)))
        return case

    def keys(self, number: int) -> dict[str, Any]:
        """Return the dotted keys and raw values of one case."""
        return varied_keys(self.base, self._parts, self.rows[number])

    @cached_property
    def _parts(self) -> list[tuple[str, int | str | None]]:
        return [split_key(name) for name in self.names]


@dataclass
class _Checked:
    """What is known of a stretch of a draft's rows, each list with one item a good case.

    Parameters
    ----------
    ids : of the cases.
    rows : raw values.
    pickled : the cases.
    operators : what the operator of each depends on.
    moduli : Young's moduli of lower and upper.
    work : estimated seconds of stepping.
    largest : of the cases that share an operator, the one that stores most.
    operator_faults : what is wrong with the size or the mesh of each operator.
    faults : of each of the first bad cases.
    bad : number of bad cases.
    """

    ids: list[str]
    rows: list[tuple[Any, ...]]
    pickled: list[bytes]
    operators: list[Hashable]
    moduli: list[tuple[float, float]]
    work: list[float]
    largest: dict[Hashable, Case]
    operator_faults: dict[Hashable, tuple[str, ...]]
    faults: list[tuple[str, ...]]
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
    every = _check_rows(draft, 0, len(draft.rows), ranks_per_case)
    return _complete(draft, [every], ranks_per_case)


def read_study_together(
    source: Path | str | Mapping[str, Any], ranks_per_case: int, comm: "MPI.Intracomm"
) -> Study | None:
    """Read a study as ``read_study``, every rank checking its share of the cases.

    Collective on comm; returned on rank 0, None elsewhere.
    """
    from ringwear_par.parallel import on_first_rank, together

    draft = on_first_rank(comm, lambda: read_draft(source))
    first, last = (len(draft.rows) * i // comm.size for i in (comm.rank, comm.rank + 1))
    with together(comm):
        mine = _check_rows(draft, first, last, ranks_per_case)
    stretches = comm.gather(mine)
    study = None
    with together(comm):
        if stretches is not None:
            study = _complete(draft, stretches, ranks_per_case)
    return study


def case_id(case_keys: Mapping[str, Any]) -> str:
    """Return the id of a case, from all that its results depend on: 16 hexadecimal digits.

    Parameters
    ----------
    case_keys : dotted keys and raw values of a good case.
    """
    content = {}
    for path in sorted(case_keys.keys() - {"title"}):
        value = BY_PATH[path].read(case_keys[path])
        if value != _NOT_IN_IDS.get(path, BY_PATH[path].default):
            content[path] = value
        if path.startswith("wear.") and path.endswith(".file"):  # what it says, not where it is
            content[path] = read_text(Path(case_keys[path]))
    return hashlib.sha256(json.dumps(content, default=repr).encode()).hexdigest()[:16]


def _check_rows(draft: Draft, first: int, last: int, ranks: int) -> _Checked:
    """Make every case of a stretch of the rows once, and look what is wrong with them."""
    parts = [split_key(name) for name in draft.names]
    found = _Checked([], [], [], [], [], [], {}, {}, [], 0)
    for number in range(first, last):
        keys = varied_keys(draft.base, parts, draft.rows[number])
        name = f"{draft.name}: case {number + 1}"
        try:
            case = make_case(keys, name, text="")
            refuse_bad_laws(case, name)
            check_ranks(case, ranks, name)
        except InputError as error:
            found.bad += 1
            if found.bad <= _FAULTS_TOLD:
                found.faults.append(error.faults)
            continue
        operator = operator_key(case)
        found.ids.append(case_id(keys))
        found.rows.append(draft.rows[number])
        found.pickled.append(pickle.dumps(case))
        found.operators.append(operator)
        found.moduli.append((case.lower.young, case.upper.young))
        found.work.append(_stepping_work(case))
        there = found.largest.setdefault(operator, case)
        if there.stored_rows < case.stored_rows:
            found.largest[operator] = case
        if operator not in found.operator_faults:
            try:
                check_memory(case, ranks, draft.name)  # first: a mesh takes memory as well
                check_mesh(case, draft.name)
                found.operator_faults[operator] = ()
            except InputError as error:
                found.operator_faults[operator] = error.faults
    return found


def _complete(draft: Draft, stretches: Sequence[_Checked], ranks: int) -> Study:
    """Join stretches of checked rows: refuse bad ones, drop repetitions, and group by operator."""
    number: dict[str, int] = {}
    rows: list[tuple[Any, ...]] = []
    pickled: list[bytes] = []
    work: list[float] = []
    groups: dict[Hashable, list[tuple[tuple[float, float], int]]] = defaultdict(list)
    largest: dict[Hashable, Case] = {}
    operator_faults: dict[Hashable, tuple[str, ...]] = {}
    for part in stretches:
        for i, identity in enumerate(part.ids):
            if identity in number:
                continue
            number[identity] = len(rows)
            groups[part.operators[i]].append((part.moduli[i], len(rows)))
            rows.append(part.rows[i])
            pickled.append(part.pickled[i])
            work.append(part.work[i])
        for operator, case in part.largest.items():
            there = largest.setdefault(operator, case)
            if there.stored_rows < case.stored_rows:
                largest[operator] = case
        operator_faults = {**part.operator_faults, **operator_faults}
    _refuse(draft, stretches, largest, operator_faults, ranks)
    worked = np.array(work)
    indices = {key: tuple(i for _, i in sorted(members)) for key, members in groups.items()}
    assembly = {key: _assembly_work(largest[key]) for key in groups}
    order = sorted(
        indices, key=lambda k: (-assembly[k] - worked[list(indices[k])].sum(), indices[k][0])
    )
    return Study(
        draft.name, draft.text, dict(draft.base), draft.names, draft.method, tuple(rows),
        tuple(number), tuple(pickled), tuple(indices[k] for k in order), worked,
        np.array([assembly[k] for k in order]),
    )  # fmt: skip


def _refuse(
    draft: Draft,
    stretches: Sequence[_Checked],
    largest: Mapping[Hashable, Case],
    operator_faults: Mapping[Hashable, tuple[str, ...]],
    ranks: int,
) -> None:
    """Raise what is wrong with the cases of a study, if anything."""
    faults: list[str] = []
    told = 0
    for part in stretches:
        for one in part.faults[: _FAULTS_TOLD - told]:
            faults += one
        told += len(part.faults[: _FAULTS_TOLD - told])
    bad = sum(part.bad for part in stretches)
    if bad > told:
        faults.append(f"{draft.name}: {bad - told} more of {len(draft.rows)} cases are bad")
    for operator, case in largest.items():
        try:
            check_memory(case, ranks, draft.name)
            found = operator_faults[operator]
        except InputError as error:
            found = error.faults
        faults += [fault for fault in found if fault not in faults]
    if faults:
        raise InputError(*faults)


def _stepping_work(case: Case) -> float:
    """Return about the seconds of a case's steps: a constant and the work on the matrix a step."""
    return 1e-4 * case.about_steps * (1.0 + (case.mesh.contact_elements / 220.0) ** 2)


def _assembly_work(case: Case) -> float:
    """Return about the seconds of a case's boundary elements: n^2 assembly, n^3 factorisation."""
    rings = case.rings
    n = sum(count_elements(case.section(ring), case.contact, case.mesh) for ring in rings)
    return 0.04 * (n / 318.0) ** 2 + 0.006 * (n / 318.0) ** 3
