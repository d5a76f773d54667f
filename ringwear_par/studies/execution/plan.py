"""The plan of a sweep: the cases of a study, or of a slice of it, that are not stored yet."""

import logging
import os
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import BoolArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.errors import InputError
from ringwear_par.files.folders import refuse_others
from ringwear_par.history.refusals.cases import memory_needed
from ringwear_par.studies.definition.study import Study
from ringwear_par.studies.definition.varied_columns import Groups
from ringwear_par.studies.storage.blocks import DONE, FAILED
from ringwear_par.studies.storage.case_index import EMPTY, CaseIndex
from ringwear_par.studies.storage.folder import SweepFolder, locked
from ringwear_par.studies.storage.results_file import RESULTS
from ringwear_par.version import __version__

log = logging.getLogger(__name__)

_MOST_SLICES = 100_000


@dataclass(frozen=True)
class Request:
    """How a study is to be computed."""

    #: of the results
    folder: Path
    #: of the sweep
    ranks: int
    #: size of the teams; divides the number of ranks
    ranks_per_case: int = 1
    #: which slice, and of how many; None for the whole, which merges
    part: tuple[int, int] | None = None
    #: compute failed cases again
    retry_failed: bool = False

    @property
    def teams(self) -> int:
        """Number of teams."""
        return self.ranks // self.ranks_per_case

    def check(self) -> None:
        """Refuse numbers that do not go together. Not collective."""
        if self.part is not None:
            number, count = self.part
            if not 1 <= number <= count <= _MOST_SLICES:
                raise InputError(
                    f"--slice {number}/{count}: must be I/N with I from 1 to N, and N at most "
                    f"{_MOST_SLICES}"
                )
        m = self.ranks_per_case
        if m < 1 or self.ranks % m:
            sizes = ", ".join(str(d) for d in range(1, self.ranks + 1) if self.ranks % d == 0)
            raise InputError(
                f"--ranks-per-case {m}: {self.ranks} ranks do not divide into teams of {m}; must "
                f"be one of {sizes}"
            )


class CaseSet(NamedTuple):
    """Some cases of a study."""

    #: the cases
    cases: Sequence[Case]
    #: of the cases
    ids: Sequence[str]
    #: which kinds they are of, see ``CaseColumns``
    kinds: Sequence[int]

    def part(self, places: Sequence[int]) -> "CaseSet":
        """Return some of them."""
        cases, ids = [self.cases[i] for i in places], [self.ids[i] for i in places]
        return CaseSet(cases, ids, [self.kinds[i] for i in places])


@dataclass(frozen=True)
class Plan:
    """The cases that a sweep computes, the same on all ranks."""

    #: how it is computed
    request: Request
    #: the study
    study: Study
    #: files of the sweep
    folder: SweepFolder
    #: for each group of the study, its cases that are to be computed here
    todo: Groups
    #: ids of cases that were interrupted
    checkpoints: frozenset[str]
    #: (cases,) which cases are of this slice
    in_slice: BoolArray
    #: how many of them had ended before
    done: int
    failed: int
    #: how many cases the folder holds that are not of the study
    not_in_study: int
    #: how many have the same flags, by these
    flagged: Counter[tuple[str, ...]]
    #: whether all ranks assemble each operator (there are fewer than teams) or the team that takes
    #: its group
    all_assemble: bool

    @property
    def total(self) -> int:
        """Number of the cases of this study, or slice."""
        return int(self.in_slice.sum())

    def count(self, index: CaseIndex) -> tuple[int, int]:
        """Return how many of the cases are stored, done and failed."""
        entry = index.find(self.study.identities[self.in_slice])
        status = index["status"][entry[entry >= 0]]
        return int((status == DONE).sum()), int((status == FAILED).sum())

    @property
    def cases_left(self) -> int:
        """Number of the cases that are to be computed."""
        return len(self.todo.cases)

    def cases(self, group: int, first: int, count: int) -> CaseSet:
        """Return some cases of a group that are to be computed, from a place on."""
        numbers = self.todo[group][first : first + count]
        ids: list[str] = self.study.identities[numbers].astype(str).tolist()
        kinds: list[int] = self.study.cases.kinds[numbers].tolist()
        return CaseSet(self.study.cases_of(numbers), ids, kinds)

    @property
    def left(self) -> list[int]:
        """Numbers of the groups that still have cases."""
        return np.flatnonzero(self.todo.sizes).tolist()

    def first_case(self, group: int) -> Case:
        """Return the first case of a group that is to be computed."""
        return self.study.case(int(self.todo[group][0]))

    def memory_needed(self) -> float:
        """Return an estimate of the bytes that all ranks need together, libraries excluded.

        Where teams assemble, as many as there are do so at once; the largest operators come first.
        """
        request, left = self.request, self.left
        if not left:
            return 0.0
        first = [self.first_case(group) for group in left]
        if self.all_assemble:
            # beside the one history that this counts, every other team has its own
            histories = max(
                8.0 * len(case.output.fields) * case.mesh.contact_elements * case.stored_rows
                for case in first
            )
            largest = max(memory_needed(case, request.ranks) for case in first)
            return largest + (request.teams - 1) * histories
        needed = sorted(
            (memory_needed(case, request.ranks_per_case) for case in first), reverse=True
        )
        return sum(needed[: request.teams])


def make_plan(study: Study, request: Request, locks: ExitStack | None) -> Plan:
    """Look which cases of a study are stored; locks keep the lock on their folder. On one rank.

    Without locks the folder is only looked at. InputError for the folder, a file in it or memory;
    ComputationError for a folder that a killed sweep still uses.
    """
    path, part = request.folder, request.part
    folder = SweepFolder(path, f"{part[0]}-{part[1]}" if part else "")
    index = EMPTY
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file; must be a folder, or a new name")
    refuse_others(path, "sweep")
    if locks is not None:
        folder.open()
        locks.enter_context(locked(path, folder.part))
        folder.clear()
        index, notes = folder.scan(mend=True)
        for note in notes:
            log.warning("%s", note)
    elif (path / "shards").is_dir() or (path / RESULTS).exists():
        with locked(path, folder.part):
            index, _ = folder.scan(mend=False)
    in_slice = _slice(study, part)
    entry = index.find(study.identities)
    status = np.where(entry >= 0, index["status"][entry], -1) if len(index) else entry
    ended = (status == DONE) | ((status == FAILED) & (not request.retry_failed))
    todo = study.members.only(in_slice & ~ended)
    _refuse_other_versions(path, index, entry[ended], bool(len(todo.cases)))
    stored = in_slice & ended
    flags: Counter[tuple[str, ...]] = Counter()
    for kind, n in Counter(index["kind"][entry[stored]].tolist()).items():
        if index.kinds[kind].flags:
            flags[index.kinds[kind].flags] += n
    plan = Plan(
        request,
        study,
        folder,
        todo,
        frozenset(path.stem for path in folder.checkpoints()),
        in_slice,
        int((status[stored] == DONE).sum()),
        int((status[stored] == FAILED).sum()),
        len(index) - int((entry >= 0).sum()),
        flags,
        len(study.members) <= request.teams,
    )  # fmt: skip
    _check_memory(plan)
    return plan


def _refuse_other_versions(folder: Path, index: CaseIndex, stored: IntArray, more: bool) -> None:
    """Refuse to bring cases of several versions together: stored ones, and more or none."""
    counts: Counter[str] = Counter()
    for kind, n in Counter(index["kind"][stored].tolist()).items():
        counts[index.kinds[kind].version] += n
    if more:
        counts.setdefault(__version__, 0)
    if len(counts) > 1:
        known = ", ".join(f"{n} by {version}" for version, n in counts.most_common() if n)
        raise InputError(
            f"{folder}: holds cases computed by another version of ringwear-par ({known}; this is "
            f"{__version__}); must be a new folder"
        )


def _check_memory(plan: Plan) -> None:
    """Refuse a plan that this machine has no memory for, as if all ranks were on it."""
    needed = plan.memory_needed()
    memory = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    teams, m = plan.request.teams, plan.request.ranks_per_case
    if needed > 0.9 * memory:
        raise InputError(
            f"{plan.study.name}: {teams} team{'s' if teams > 1 else ''} of {m} "
            f"rank{'s' if m > 1 else ''} need about {needed / 1e9:.3g} GB of memory at once, this "
            f"machine has {memory / 1e9:.3g} GB; must be less: fewer ranks, more of them a case "
            "(--ranks-per-case), or smaller cases"
        )


def _slice(study: Study, part: tuple[int, int] | None) -> BoolArray:
    """Return which cases are of a slice: a stretch of the groups, by estimated work."""
    groups = study.members
    if part is None:
        return np.ones(len(groups.cases), dtype=bool)
    share = np.repeat(study.assembly / groups.sizes, groups.sizes)
    work = study.work[groups.cases] + share
    middle = (np.cumsum(work) - 0.5 * work) / work.sum()
    number = np.minimum((middle * part[1]).astype(int), part[1] - 1)
    in_slice = np.zeros(len(number), dtype=bool)
    in_slice[groups.cases] = number == part[0] - 1
    return in_slice
