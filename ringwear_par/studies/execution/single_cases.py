"""Cases that are computed alone, with checkpoints: long ones, and those of teams of ranks."""

from collections.abc import Sequence
from dataclasses import replace

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.errors import ComputationError, InputError, UnfitError
from ringwear_par.history.lockstep import must_run_alone
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.snapshots import Observer
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import HistoryColumns
from ringwear_par.results.run import CheckpointWatch
from ringwear_par.results.signals import StopSignals
from ringwear_par.studies.execution.batches import PairResources
from ringwear_par.studies.execution.team_store import StorageError, TeamStore

#: histories of more steps are computed alone, with checkpoints
LONG_STEPS = 20_000


def is_batchable(case: Case) -> bool:
    """Tell whether a case may be stepped side by side with others."""
    return case.about_steps <= LONG_STEPS and not must_run_alone(case)


def simulate_alone(
    case: Case,
    identity: str,
    resources: PairResources,
    store: TeamStore,
    signals: StopSignals,
    observers: Sequence[Observer],
    comm: MPI.Comm,
) -> HistoryColumns:
    """Return a case's history to its end, or to a checkpoint that a signal made it write.

    Collective on comm: an error of one rank is raised on all, StorageError of the disk among them.
    """
    before = store.read_checkpoint(identity)
    recorder = Recorder([case], comm, before, stresses=resources.stresses)
    failures: dict[int, Exception] = {}

    def save() -> None:
        store.write_checkpoint(identity, recorder.result())

    try:
        simulate_one(
            case, comm, pair=resources.pair, start=recorder.start,
            observers=[recorder, *observers, CheckpointWatch(signals, save, comm)],
        )  # fmt: skip
    except (StorageError, KeyboardInterrupt):
        raise
    except Exception as error:  # of the solver, or of a law that is not ours
        if isinstance(error, InputError) and not isinstance(error, UnfitError):
            raise  # an option for PETSc, not the case
        failures[0] = error
    columns = recorder.columns(failures)
    if failures or recorder.finished:
        return columns
    if recorder.last is not None:
        try:
            save()
        except ComputationError as error:
            raise StorageError(str(error)) from error
    return replace(columns, status=("incomplete",))
