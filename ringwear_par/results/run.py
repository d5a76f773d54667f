"""``ringwear run``: a case from its file to its result file."""

import json
import logging
import os
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ringwear_par.atomic import check_writable
from ringwear_par.cases.case import Case
from ringwear_par.cases.law_trials import law_sources, refuse_bad_laws
from ringwear_par.cases.reading import parse_case, read_case
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.elasticity.assembly import load_kernels
from ringwear_par.elasticity.pair import ContactCompliance
from ringwear_par.errors import ComputationError, InputError, UnfitError
from ringwear_par.history.limits import check_memory, check_mesh
from ringwear_par.history.model import State, WearHistory, run
from ringwear_par.history.pairs import assemble, boundary_recovery, updated_geometry, young
from ringwear_par.info import versions
from ringwear_par.options import reject_unused_options
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.doubts import Doubt, doubts, instability
from ringwear_par.results.files import (
    Checkpoint,
    Recorder,
    read_checkpoint,
    read_status,
    write_result,
)
from ringwear_par.results.progress import Monitor, Progress, StopSignals

log = logging.getLogger(__name__)


def run_case(
    path: Path,
    output: Path,
    overrides: Sequence[str],
    restart: bool,
    figure: Path | None,
    comm: MPI.Comm,
) -> int:
    """Compute a wear history and write it; return the exit status. Collective on comm.

    Raises
    ------
    InputError : the case, the options or the output, before any work and with nothing written.
    ComputationError : the contact failed, or the result could not be written.
    """
    started = time.perf_counter()
    case, checkpoint = on_first_rank(
        comm, lambda: _prepare(path, output, overrides, restart, figure, comm.size)
    )
    if checkpoint is not None and case.time.finished(checkpoint.state.step, checkpoint.state.time):
        if comm.rank == 0:
            log.info("%s is complete: nothing to compute", output)
        return _draw(output, figure, comm)
    if comm.rank == 0:
        warn_of_threads(comm.size)

    t0 = time.perf_counter()
    load_kernels(comm)
    loading = time.perf_counter() - t0
    elasticity = None
    if case.follows_wear:
        elasticity = updated_geometry(case, comm)
        unworn = elasticity.update(np.zeros((2, case.line.n)))
    else:
        unworn = assemble(case, comm)
    pair, cost = unworn.compliance(young(case)), unworn.cost
    with ContactSolver(pair.matrix, pair.line.area, comm) as solver:
        boundary = None if case.output.boundary == "none" else boundary_recovery(case, comm)
        history = WearHistory(case, pair, solver, elasticity, boundary)
        recorder = Recorder(history) if comm.rank == 0 else None
        begun = time.perf_counter()
        try:
            state = history.start()
        except UnfitError as error:
            raise InputError(*(f"{path}: {fault}" for fault in error.faults)) from error
        _warn(instability(history), comm)
        reject_unused_options()
        if checkpoint is not None:
            state = checkpoint.state
            history.resume(state, checkpoint.warm)
        if recorder is not None and checkpoint is None:
            recorder.add(state)
        elif recorder is not None and checkpoint is not None:
            recorder.restore(checkpoint)
            log.info("continuing %s after step %d (%g s)", output, state.step, state.time)
        before = checkpoint.seconds if checkpoint is not None else {}
        seconds = {
            "seconds_assembly": cost.seconds_assembly,
            "seconds_factorisation": cost.seconds_solution,
            "seconds_stepping": 0.0,
            "seconds_output": 0.0,
        }

        def save(state: State) -> None:
            t0 = time.perf_counter()
            warm = solver.warm()
            moving = history.following
            seconds["seconds_assembly"] = cost.seconds_assembly + moving.seconds_assembly
            seconds["seconds_factorisation"] = cost.seconds_solution + moving.seconds_solution
            following = moving.seconds_assembly + moving.seconds_solution
            seconds["seconds_stepping"] = t0 - begun - seconds["seconds_output"] - following
            spent = {name: value + before.get(name, 0.0) for name, value in seconds.items()}
            attributes = {
                "status": "complete" if history.finished(state) else "incomplete",
                "ranks": comm.size,
                **versions(),
                **spent,
                "symmetry_defect": pair.symmetry_defect,
                "user_laws": json.dumps(law_sources(case)),
            }

            def write() -> None:
                assert recorder is not None
                write_result(output, case, pair.line, recorder, state, warm, attributes)

            on_first_rank(comm, write)
            seconds["seconds_output"] += time.perf_counter() - t0

        with StopSignals() as signals, ExitStack() as at_end:
            progress = None
            if comm.rank == 0:
                progress = at_end.enter_context(closing(Progress(state.time, case.time.end)))
            monitor = Monitor(history.finished, recorder, save, signals, comm, progress)
            try:
                state = run(history, state, monitor, monitor.show)
            except ComputationError as error:
                if monitor.last is None:
                    raise
                save(monitor.last)
                raise ComputationError(f"{error}; {output} holds the steps before it") from error
            save(state)
        if recorder is not None:
            print(summary(case, history.pair, state, recorder))
            if case.follows_wear:
                moving = history.following
                print(
                    f"elements followed the wear {state.assemblies} times (every "
                    f"{case.mesh.geometry_tolerance:g} mm): {moving.kernel_evaluations} kernel "
                    f"evaluations, {moving.seconds_assembly + moving.seconds_solution:.3f} s"
                )
            _warn(doubts(case, history.pair, state), comm)
            start_up = max(seconds_since_start() - (time.perf_counter() - started), 0.0)
            print(_times(seconds, start_up, loading, cost.kernel_evaluations))
    if not history.finished(state):
        raise ComputationError(
            f"stopped by {monitor.signal_name} after step {state.step} {_progress(case, state)}; "
            f"{output} holds them, and the same command with --restart continues"
        )
    return _draw(output, figure, comm)


def _progress(case: Case, state: State) -> str:
    """Return how far a state is."""
    if case.time.adaptive:
        return f"(at {state.time:g} of {case.time.end:g} s)"
    return f"of {case.time.steps}"


def _draw(output: Path, figure: Path | None, comm: MPI.Comm) -> int:
    if figure is not None:
        from ringwear_par.results.figures import plot_files

        on_first_rank(comm, lambda: plot_files([output], figure))
    return 0


def summary(case: Case, pair: ContactCompliance, state: State, recorder: Recorder) -> str:
    """Return the end of a run in a few lines, balances included. Not collective."""
    scalars, last = recorder.scalars, recorder.stored - 1
    balances, p = state.balances, state.contact.pressure
    lower, upper = 1e3 * state.wear.max(axis=1)
    energy_holds = any(law is not None and law.per_energy(case.friction) for law in case.laws)
    if case.time.adaptive:
        made = (
            f"{state.step} adaptive steps (and {state.rejected} repeated) to {state.time:g} s, "
            f"tolerance {case.time.tolerance:g} mm"
        )
    else:
        made = f"{state.step} of {case.time.steps} {case.time.scheme} steps of {case.time.step:g} s"
    lines = [
        *([case.title] if case.title else []),
        f"{made}, {pair.line.n} contact elements, "
        f"{state.iterations / max(state.step, 1):.1f} TAO iterations a step",
        f"approach {state.contact.approach:.7g} mm, "
        f"penetration {1e3 * scalars['penetration'][last]:.6g} um, "
        f"force {state.contact.force:.6g} N, torque {scalars['torque'][last]:.6g} N mm",
        f"deepest wear lower {lower:.6g}, upper {upper:.6g} um; "
        f"worn volume lower {scalars['worn_volume_lower'][last]:.6g}, "
        f"upper {scalars['worn_volume_upper'][last]:.6g} mm3; "
        f"energy dissipated {state.energy:.6g} N mm",
        f"pressure {p.min():.4g} to {p.max():.4g} MPa, "
        f"{np.count_nonzero(p > 0.0)} of {len(p)} elements in contact",
        "balances, worst of all steps: "
        + (f"force {balances.force:.1e}, " if case.load.force is not None else "")
        + f"volume {balances.volume:.1e}, "
        + (
            f"energy {balances.energy:.1e}, "
            if energy_holds
            else "energy (this law: no identity), "
        )
        + f"contact (KKT) {balances.residual:.1e}",
        "defects of the boundary elements, which vanish with the mesh: torque on the fixed faces "
        f"{balances.torque:.1e}, force on them {balances.reaction:.1e}, "
        f"symmetry {pair.symmetry_defect:.1e}",
    ]
    return "\n".join(lines)


def _times(seconds: dict[str, float], start_up: float, loading: float, evaluations: int) -> str:
    names = ("assembly", "factorisation", "stepping", "output")
    parts = ", ".join(f"{name} {seconds[f'seconds_{name}']:.3f}" for name in names)
    return (
        f"seconds: start-up {start_up:.2f}, compiled code {loading:.2f}, {parts} "
        f"({evaluations} kernel evaluations)"
    )


def seconds_since_start() -> float:
    """Return the age of this process, s; 0 where the system does not tell. Not collective."""
    try:
        started = float(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        uptime = float(Path("/proc/uptime").read_text().split()[0])
    except (OSError, IndexError, ValueError):
        return 0.0
    return uptime - started / os.sysconf("SC_CLK_TCK")


def _prepare(
    path: Path,
    output: Path,
    overrides: Sequence[str],
    restart: bool,
    figure: Path | None,
    ranks: int,
) -> tuple[Case, Checkpoint | None]:
    """Read and check all that a run needs, before any work. On one rank."""
    faults: list[str] = []
    case = checkpoint = None
    try:
        case = read_case(path, overrides)
        refuse_bad_laws(case, ranks, str(path))
        check_memory(case, ranks, str(path))
        check_mesh(case, str(path))
    except InputError as error:
        faults += error.faults
    try:
        check_writable(output)
        there = read_status(output)
        if there is not None and restart and case is not None:
            text, checkpoint = read_checkpoint(output)
            if checkpoint.user_laws != law_sources(case):
                raise InputError(
                    f"{output}: was computed with another wear law in a Python file than there is "
                    "now; --restart needs the same"
                )
            _check_same(case, text, checkpoint.state, output)
        elif there is not None and there[0] == "incomplete" and not restart:
            raise InputError(
                f"{output}: holds a run that was interrupted after step {there[1]}; "
                "--restart continues it, removing the file starts anew"
            )
    except InputError as error:
        faults += error.faults
    if figure is not None:
        from ringwear_par.results.figures import check_figure

        try:
            check_figure(figure, case.output if case is not None else None)
        except InputError as error:
            faults += error.faults
    if faults or case is None:
        raise InputError(*faults)
    return case, checkpoint


def _check_same(case: Case, text: str, reached: State, output: Path) -> None:
    stored = parse_case(text, str(output))
    same = replace(stored, time=case.time, title=case.title, text=case.text)
    longer = replace(stored.time, steps=case.time.steps, until=case.time.until)
    growing = "time.end" if case.time.adaptive else "time.steps"
    if same != case or longer != case.time:
        raise InputError(
            f"{output}: holds another case; --restart needs the same case, only {growing} may grow"
        )
    if case.time.adaptive and reached.time > case.time.end:
        raise InputError(
            f"{output}: holds {reached.time:g} s, time.end = {case.time.end:g}: must be at least "
            "as long with --restart"
        )
    if not case.time.adaptive and reached.step > case.time.steps:
        raise InputError(
            f"{output}: holds {reached.step} steps, time.steps = {case.time.steps}: must be at "
            "least as many with --restart"
        )


def warn_of_threads(ranks: int) -> None:
    """Warn where BLAS threads and ranks are more than the cores. On one rank."""
    cores = os.cpu_count() or 1
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
    threads = next((int(os.environ[n]) for n in names if os.environ.get(n, "").isdigit()), cores)
    if ranks > 1 and threads > 1 and threads * ranks > cores:
        log.warning(
            "%d ranks with up to %d BLAS threads each on %d cores: set OPENBLAS_NUM_THREADS=1",
            ranks, threads, cores,
        )  # fmt: skip


def _warn(found: Sequence[Doubt], comm: MPI.Comm) -> None:
    if comm.rank == 0:
        for doubt in found:
            log.warning("%s", doubt.text)
