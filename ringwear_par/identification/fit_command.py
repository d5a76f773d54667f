"""``ringwear fit``: a fit into a folder; and what other commands that write one do alike."""

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

from mpi4py import MPI

from ringwear_par.files.folders import check_folder
from ringwear_par.files.writing import announce_replacement, closing_line
from ringwear_par.identification import fit_folder
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.expectation import expectation
from ringwear_par.identification.fit import fit_problem
from ringwear_par.parallel import on_first_rank, warn_of_threads
from ringwear_par.results.result import Outcome

log = logging.getLogger(__name__)


def into_folder(
    folder: Path,
    files: Sequence[str],
    comm: MPI.Intracomm,
    compute: Callable[[], Outcome],
    *,
    overwrite: bool = False,
) -> None:
    """Write an outcome to a folder, and print its summary. Collective on comm.

    Parameters
    ----------
    files : that it has; the first one, which says that it is whole, is announced where there is one
        and it may not simply be overwritten.
    compute : returns the outcome; collective.
    """

    def check() -> None:
        check_folder(folder, files, "fit")
        if not overwrite:
            announce_replacement(folder / files[0])

    on_first_rank(comm, check)
    result = compute()
    on_first_rank(comm, lambda: result.save(folder))
    if comm.rank == 0:
        print(result.summary())
        print(closing_line(folder, files))


def run_fit(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    dry_run: bool = False,
    overwrite: bool = False,
    compare: bool = False,
) -> None:
    """Fit and write the outcome to a folder, or in a dry run print what to expect. Collective."""
    problem = on_first_rank(comm, lambda: read_fit(source, plans=dry_run))
    if dry_run:
        expected = expectation(problem, comm)
        if comm.rank == 0:
            print(expected)
        return
    if comm.rank == 0:
        warn_of_threads(comm.size)
    into_folder(
        folder, fit_folder.FILES, comm, lambda: fit_problem(problem, comm, compare=compare),
        overwrite=overwrite,
    )  # fmt: skip
    if comm.rank == 0 and problem.alternatives and not compare:
        names = ", ".join(problem.alternatives)
        log.info("laws of [compare] were not fitted: --compare fits %s", names)
