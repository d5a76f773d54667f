"""Times of each part of the work at several sizes, on the ranks it is started with.

Usage: [mpirun -n N] python scripts/benchmark.py [--sizes 32 64 128 256] [--repeats 5] [--csv F]
   or: python scripts/benchmark.py --ensembles 2048 [--sizes 64] [--repeats 5]
   or: python scripts/benchmark.py --derivatives 128 [--sizes 64] [--repeats 5]

The paper's rings, 80 MPa and p0 = 40 MPa. Every time is the median over the repeats (after one that
is not counted) of the slowest rank's wall time; memory is the largest rank's peak so far, which
grows with the sizes. Steps are made by every rank on its own (active-set Newton) and, "shared",
with the matrix spread over the ranks (tron; on one rank the same as the former). The adaptive
history reaches the same 200 s; "updated" are 200 steps with elements that follow the wear, their
re-assemblies included, the first assembly not. "Recorded" are the same histories through the front
door, with their checks, balances and results. On one rank, "run" is ``ringwear run`` with its
start, once of a shape that is assembled and once of one that is known. Counts: kernel evaluations
(both bodies, all directions), flops of the factorisations 2/3 n^3.

Of ensembles, so many cases of each kind, see ``benchmark_ensembles``; of derivatives
``benchmark_derivatives``.
"""

import argparse
import csv
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import benchmark_derivatives
import benchmark_ensembles
import numpy as np
from mpi4py import MPI

import ringwear_par as rw
from ringwear_par.cases.case import Case, Stepping
from ringwear_par.contact.engine import ContactEngine
from ringwear_par.contact.scaled_compliances import ScaledCompliances
from ringwear_par.elasticity import pair_cache
from ringwear_par.elasticity.bem.assembly import assemble
from ringwear_par.elasticity.bem.body import body_zones
from ringwear_par.elasticity.bem.pair import assemble_pair
from ringwear_par.elasticity.bem.quadrature import quadrature
from ringwear_par.elasticity.bem.solve import solve_systems
from ringwear_par.elasticity.bem.systems import number_dofs
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.history.elastic.bodies import bodies, young
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.parallel import peak_memory

COLUMNS = (
    "contact_elements", "ranks", "boundary_elements", "unknowns", "kernel_evaluations",
    "assembly_s", "ns_per_evaluation", "factor_solve_s", "gflop_per_s", "compliance_s",
    "first_contact_ms", "steps_200_s",
    "ms_per_step", "steps_200_recorded_s", "adaptive_200_s",
    "adaptive_200_recorded_s", "updated_200_steps_s", "run_s", "run_known_s", "peak_MB_per_rank",
)  # fmt: skip


def timed(comm: MPI.Comm, repeats: int, action: Callable[[], float | object]) -> float:
    """Return the median wall time of an action, s, on the slowest rank. Collective.

    Parameters
    ----------
    action : what is timed; one that returns a float has timed itself, s.
    """
    times = []
    for _ in range(repeats + 1):
        comm.Barrier()
        started = time.perf_counter()
        own = action()
        seconds = own if isinstance(own, float) else time.perf_counter() - started
        times.append(comm.allreduce(seconds, MPI.MAX))
    return median(times[1:])


def timed_commands(n: int, repeats: int) -> tuple[float, float]:
    """Return the wall time of ``ringwear run``, s: without kept operators, and with its own."""
    case = Path(__file__).parent / "cases" / "paper.toml"
    with TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "ringwear_par", "run", str(case), "-o", f"{folder}/run.h5"]
        words += ["--set", f"mesh.contact_elements={n}"]
        environment = {**os.environ, pair_cache.VARIABLE: f"{folder}/kept"}

        def run(*more: str) -> None:
            subprocess.run(
                [*words, *more], env=environment, check=True, capture_output=True, timeout=600
            )

        alone = MPI.COMM_SELF
        return timed(alone, repeats, lambda: run("--no-cache")), timed(alone, repeats, run)


def measure(n: int, repeats: int, comm: MPI.Comm) -> dict[str, float]:
    """Return one row of the table. Collective."""
    case = rw.read_case(
        Path(__file__).parent / "cases" / "paper.toml", [f"mesh.contact_elements={n}"]
    )
    rules = quadrature(Mesh().quadrature_tolerance)
    zones = [body_zones(body, case.line, case.mesh) for body in bodies(case)]
    dofs = [number_dofs(body) for body in zones]
    elements = sum(len(zone.boundary.elements) for body in zones for zone in body)

    def assembled() -> list:
        parts = zip(zones, dofs, strict=True)
        return [assemble(body, own, rules, comm) for body, own in parts]

    systems, evaluations = [], 0
    for rows in assembled():
        evaluations += comm.allreduce(rows.kernel_evaluations)
        systems += [rows.normal, rows.torsion]
    sizes = [system.matrix.shape[1] for system in systems]
    flops = sum(2.0 / 3.0 * size**3 + 2.0 * size**2 * n for size in sizes)
    assembly = timed(comm, repeats, assembled)
    solution = timed(comm, repeats, lambda: solve_systems(systems, comm))
    systems.clear()
    both = timed(
        comm, repeats,
        lambda: assemble_pair(bodies(case), case.line, case.mesh, comm),
    )  # fmt: skip
    pair = rw.assemble(case, comm, use_kept=False)
    area, matrix = pair.line.area, pair.compliance(young(case)).matrix
    grown = replace(case, time=Stepping("adaptive", until=200.0))
    moving = replace(case, mesh=Mesh(n, geometry="updated"))

    def first_contact() -> None:
        compliances = ScaledCompliances.of(matrix[None], area)
        with ContactEngine(compliances, np.zeros(1, dtype=np.int64)) as engine:
            engine.solve(np.zeros((1, n)), force=np.array([case.load.force]))

    def history(case: Case) -> None:
        simulate_one(case, comm, pair=pair)

    def updated() -> float:
        started: list[float] = []

        def start(snapshot: Snapshot) -> bool:
            if snapshot.step is None:  # assembled, and in contact
                started.append(time.perf_counter())
            return False

        simulate_one(moving, comm, observers=[start])
        return time.perf_counter() - started[0]

    contact = timed(comm, repeats, first_contact)
    stepping = timed(comm, repeats, lambda: history(case))
    adaptive = timed(comm, repeats, lambda: history(grown))
    recorded = timed(comm, repeats, lambda: rw.simulate(case, comm, pair=pair))
    adaptive_recorded = timed(comm, repeats, lambda: rw.simulate(grown, comm, pair=pair))
    followed = timed(comm, repeats, updated)
    commands = timed_commands(n, repeats) if comm.size == 1 else (math.nan, math.nan)
    peak = 1e-6 * comm.allreduce(peak_memory(), MPI.MAX)
    return dict(
        zip(
            COLUMNS,
            (
                n, comm.size, elements, sum(sizes),
                evaluations, assembly, 1e9 * assembly * comm.size / evaluations, solution,
                1e-9 * flops / solution, both,
                1e3 * contact, stepping, 5.0 * stepping, recorded, adaptive,
                adaptive_recorded, followed, *commands, peak,
            ),
            strict=True,
        )
    )  # fmt: skip


def main() -> None:
    """Print the table, and write it as CSV if asked."""
    comm = MPI.COMM_WORLD
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[32, 64, 128, 256])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--ensembles", type=int, metavar="CASES")
    parser.add_argument("--derivatives", type=int, metavar="CASES")
    args = parser.parse_args()
    if args.derivatives is not None:
        for elements in args.sizes:
            benchmark_derivatives.print_table(args.derivatives, elements, args.repeats)
        return
    if args.ensembles is not None:
        for elements in args.sizes:
            benchmark_ensembles.print_table(args.ensembles, elements, args.repeats)
        return
    table = [measure(n, args.repeats, comm) for n in args.sizes]
    if comm.rank > 0:
        return
    for name in COLUMNS:
        print(f"{name:>24}", *(f"{row[name]:>12.4g}" for row in table))
    if args.csv is not None:
        with args.csv.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(table)


if __name__ == "__main__":
    sys.exit(main())
