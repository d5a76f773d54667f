"""``ringwear verify``: computed solutions against the exact ones of ``reference``."""

import time
from collections import Counter
from collections.abc import Callable, Iterator

from mpi4py import MPI

from ringwear_par.elasticity.bem.assembly import load_kernels
from ringwear_par.errors import ComputationError
from ringwear_par.verification.check import Check, Kind
from ringwear_par.verification.elasticity import cone_checks, elasticity_checks, stress_checks
from ringwear_par.verification.faces import edge_checks, slope_checks
from ringwear_par.verification.half_space import half_space_checks, sphere_checks
from ringwear_par.verification.histories import history_checks, paper_checks, tao_checks
from ringwear_par.verification.layers import layer_checks

_WIDTH = 78


#: what there is, in the order of the table that is printed
CHECKS: tuple[Callable[[MPI.Comm], Iterator[Check]], ...] = (
    elasticity_checks,
    half_space_checks,
    sphere_checks,
    paper_checks,
    layer_checks,
    stress_checks,
    edge_checks,
    cone_checks,
    slope_checks,
    tao_checks,
    history_checks,
)


def checks(comm: MPI.Comm) -> Iterator[Check]:
    """Run all checks, one after another. Collective on comm."""
    for checks_of_one_kind in CHECKS:
        yield from checks_of_one_kind(comm)


def verify(comm: MPI.Comm) -> None:
    """Print every check as it is done; ComputationError names failed ones. Collective on comm."""
    load_kernels(comm)
    started, failed = time.perf_counter(), []
    count: Counter[Kind] = Counter()
    if comm.rank == 0:
        print(
            f"{'':4} {'compared':{_WIDTH}} {'kind':9} {'elements':>8} {'error':>9} {'allowed':>8} "
            f"{'order':>6}"
        )
    for check in checks(comm):
        count[check.kind] += 1
        if not check.passed:
            failed.append(check.name)
        if comm.rank == 0:
            print(_row(check), flush=True)
    if comm.rank == 0:
        seconds = time.perf_counter() - started
        passed = f"{len(failed)} not passed" if failed else "all passed"
        print(f"{_counted(count)}: {passed} in {seconds:.0f} s", flush=True)
    if failed:
        raise ComputationError(
            f"{len(failed)} of {count.total()} checks are not passed: {'; '.join(failed)}"
        )


def _counted(count: Counter[Kind]) -> str:
    """Return how many checks there are of each kind."""
    plurals: dict[Kind, tuple[str, str]] = {
        "reference": ("reference solution", "reference solutions"),
        "identity": ("identity", "identities"),
        "bound": ("bound", "bounds"),
    }
    return ", ".join(f"{count[k]} {words[count[k] != 1]}" for k, words in plurals.items())


def _row(check: Check) -> str:
    order = f"{check.order:6.2f}" if check.order is not None else f"{'-':>6}"
    return (
        f"{'ok' if check.passed else 'FAIL':4} {check.name:{_WIDTH}} {check.kind:9} "
        f"{check.sizes[-1]:8d} {check.errors[-1]:9.1e} {check.tolerance:8.0e} {order}"
    )
