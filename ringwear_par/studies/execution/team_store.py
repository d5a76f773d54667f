"""Where a team stores its cases: those that end in its shard, checkpoints of interrupted ones."""

import logging

from mpi4py import MPI

from ringwear_par.cases.files.keys import read_keys
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.files import open_result, restored, write_result
from ringwear_par.results.hdf5 import UnreadableError
from ringwear_par.results.result import HistoryColumns, Result
from ringwear_par.studies.definition.identities import case_id
from ringwear_par.studies.execution.plan import CaseSet, Plan
from ringwear_par.studies.storage.blocks import DAMAGE, Block
from ringwear_par.studies.storage.shards import Shard
from ringwear_par.version import __version__

log = logging.getLogger(__name__)


class StorageError(ComputationError):
    """A failure of the disk, not of a case."""


class TeamStore:
    """The shard and the checkpoints of a team, by number: a context manager. Collective on comm."""

    def __init__(self, plan: Plan, number: int, comm: MPI.Comm) -> None:
        self._plan, self._comm = plan, comm
        self._checkpoints = set(plan.checkpoints)
        self._shard: Shard | None = None

        def open_shard() -> None:
            self._shard = Shard(plan.folder.shard(number))

        if plan.cases_left:
            on_first_rank(comm, open_shard)

    def __enter__(self) -> "TeamStore":
        return self

    def __exit__(self, *_: object) -> None:
        if self._shard is not None:
            self._shard.close()

    def add(self, columns: HistoryColumns, cases: CaseSet) -> HistoryColumns:
        """Store cases for good, drop checkpoints of ended ones; return stored columns."""
        case = cases.cases[0]
        deep = case.output.profiles == "all"
        texts = [case.text for case in cases.cases]
        block = Block.of(columns, case.line, cases.ids, texts, __version__, deep=deep)

        def store() -> None:
            assert self._shard is not None
            self._shard.add(block)
            for identity, status in zip(cases.ids, columns.status, strict=True):
                if identity in self._checkpoints and status != "incomplete":
                    self._plan.folder.checkpoint(identity).unlink(missing_ok=True)

        on_first_rank(self._comm, store)
        return columns

    def write_checkpoint(self, identity: str, result: Result) -> None:
        """Write a checkpoint of a case."""
        self._checkpoints.add(identity)
        path = self._plan.folder.checkpoint(identity)
        on_first_rank(self._comm, lambda: write_result(path, result))

    def read_checkpoint(self, identity: str) -> Result | None:
        """Return the checkpoint of an interrupted case; None where there is no good one."""
        if identity not in self._plan.checkpoints:
            return None
        path = self._plan.folder.checkpoint(identity)

        def read() -> Result | None:
            try:
                return _checkpoint(identity, open_result(path))
            except UnreadableError as error:
                raise ComputationError(str(error)) from error
            except InputError as error:
                path.unlink(missing_ok=True)
                log.warning("%s; this case starts anew", error)
            return None

        return on_first_rank(self._comm, read)


def _checkpoint(identity: str, result: Result) -> Result:
    """Return a result from which a case can continue, or InputError."""
    try:
        version = str(result.attributes["version"])
        restored(result)
        same = case_id(read_keys(result.case)) == identity
    except DAMAGE as error:
        raise InputError(f"{result.name}: is damaged") from error
    if not same:
        raise InputError(f"{result.name}: is of another case than its name says")
    if version != __version__:
        raise InputError(f"{result.name}: is of version {version} of ringwear-par")
    return result
