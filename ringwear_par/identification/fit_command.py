"""``ringwear fit``: a fit into a folder."""

import logging
from pathlib import Path

from mpi4py import MPI

from ringwear_par.files.folders import FIT, check_folder
from ringwear_par.files.writing import announce_replacement, closing_line
from ringwear_par.identification import fit_folder
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.expectation import expectation
from ringwear_par.identification.fit import fit_problem
from ringwear_par.parallel import on_first_rank, warn_of_threads

log = logging.getLogger(__name__)


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

    def check() -> None:
        check_folder(folder, fit_folder.FILES, "fit")
        if not overwrite:
            announce_replacement(folder / FIT)

    on_first_rank(comm, check)
    if comm.rank == 0:
        warn_of_threads(comm.size)
    result = fit_problem(problem, comm, compare=compare)
    on_first_rank(comm, lambda: result.save(folder))
    if comm.rank == 0:
        print(result.summary())
        print(closing_line(folder, fit_folder.FILES))
        if problem.alternatives and not compare:
            log.info(
                "laws of [compare] were not fitted: --compare fits %s",
                ", ".join(problem.alternatives),
            )
