"""``ringwear fit``: a fit into a folder, as far as an earlier one has not done it."""

import logging
from contextlib import suppress
from pathlib import Path

from mpi4py import MPI

from ringwear_par.errors import InputError, RingwearError
from ringwear_par.files.folders import FIT, check_folder
from ringwear_par.files.writing import announce_replacement, closing_line
from ringwear_par.identification import fit_folder
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.estimation.starts import StoredStarts
from ringwear_par.identification.fit import expected_result, fit_problem
from ringwear_par.identification.model.rounds import StoppedError
from ringwear_par.identification.summary import prediction
from ringwear_par.parallel import on_first_rank, warn_of_threads

log = logging.getLogger(__name__)


def run_fit(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    dry_run: bool = False,
    restart: bool = False,
    overwrite: bool = False,
    compare: bool = False,
) -> None:
    """Fit and write the outcome to a folder, or in a dry run print what to expect. Collective.

    A fit that fails leaves nothing; one that is stopped leaves what ``restart`` goes on with.
    """
    if restart and overwrite:
        raise InputError("--restart, --overwrite: must be one of them, to go on or to start anew")
    if dry_run:
        problem = on_first_rank(comm, lambda: read_fit(source, plans=True))
        expected = expected_result(problem, comm)
        if comm.rank == 0:
            print(prediction(expected))
        return
    problem = on_first_rank(comm, lambda: read_fit(source))
    on_first_rank(comm, lambda: check_folder(folder, fit_folder.FILES, "fit"))
    if restart and on_first_rank(
        comm, lambda: fit_folder.complete(folder, problem, compare=compare)
    ):
        if comm.rank == 0:
            log.info("%s: the fit is complete; nothing is left to be done", folder)
        return
    stored = StoredStarts(folder, "")

    def clear() -> None:
        if overwrite:
            stored.remove()
        elif restart:
            StoredStarts(folder, problem.key).refuse_others()
        else:
            fit_folder.refuse_interrupted(folder)
        announce_replacement(folder / FIT)

    on_first_rank(comm, clear)
    if comm.rank == 0:
        warn_of_threads(comm.size)
    try:
        result = fit_problem(problem, comm, compare=compare, folder=folder)
    except StoppedError:
        raise
    except RingwearError:  # the same command would fail again, and another one must be free to run
        if comm.rank == 0:
            with suppress(OSError):
                stored.remove()
        raise

    def store() -> None:
        result.save(folder)
        stored.remove()

    on_first_rank(comm, store)
    if comm.rank == 0:
        print(result.summary())
        print(closing_line(folder, fit_folder.FILES))
        if problem.alternatives and not compare:
            log.info(
                "laws of [compare] were not fitted: --compare fits %s",
                ", ".join(problem.alternatives),
            )
