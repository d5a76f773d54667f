"""Why late worn profiles may ripple, as in figure 2 of the paper: two causes and the cure.

Usage: [mpirun -n N] python scripts/step_stability.py [-o FIG.png]

Steps the paper's rings on uniform contact meshes, prints what it finds and draws it.

- Explicit steps, (6) of the paper, are stable up to kappa V dt lambda_max(C^-1) = 2, C being the
  compliance of the contact line: wear per step of less than 1.485 h p / E* where the speed is
  largest. Beyond, the worn profile alternates from element to element.
- Gaps that contact elements take from their end nodes (the mean, as linear interpolation has it)
  hardly feel pressures of alternating sign: the smallest eigenvalue of C falls as h^3, not as h.
  Unworn pressures are garbage, and the largest stable step falls as h^3 too, so that steps far
  within the limit of the mid-points' compliance make profiles ripple. Within its own limit, or
  implicit, stepping is smooth with these gaps as well: wear evens out what pressure they invent.
- Mid-point gaps and implicit steps have neither fault.

Ripples with a threshold p0 > 0 also dig too deep: pressure swings above and below it, and only the
former wears. With p0 = 0 the penetration stays right.

A ripple is the r.m.s. alternating component of the wear on the inner four fifths of the contact,
away from the edges: fourth differences over 16, which leave +-a of alternating sign as it is and
no cubic.
"""

import argparse
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, NullLocator
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.batched import one
from ringwear_par.cases.case import Case, Stepping
from ringwear_par.cases.files.reading import read_case
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.elasticity.bem.body import boundary_conditions, solve_body
from ringwear_par.elasticity.bem.boundary import boundary_mesh
from ringwear_par.elasticity.bem.pair import ContactCompliance, ContactPair, largest_stable_step
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.errors import RingwearError
from ringwear_par.history.elastic.bodies import young
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.physics import Physics
from ringwear_par.history.schemes.euler import backward, forward
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.history.start import initial_state
from ringwear_par.history.state import State
from ringwear_par.pictures.style import COLOURS, STYLE
from ringwear_par.verification.reference import EXPLICIT_LIMIT, contact_modulus
from ringwear_par.wear.laws.threshold import ThresholdLaw

CASE = Path(__file__).parent / "cases" / "paper.toml"
#: times of the worn profiles, s: the later ones of the paper
TIMES = (50.0, 100.0, 150.0, 200.0)
#: contact elements of the worn profiles, and of the stable steps
N, SIZES = 32, (16, 32, 64, 128)
#: steps, s, that divide TIMES: above the explicit limit of 12.6 s and below it; our reading
LONG, SHORT, READING = 50.0 / 3.0, 10.0, 1.0
#: true p(29) at 50 MPa mean pressure, unworn
P29 = 44.65

Gaps = Literal["mid-point", "nodal"]
Scheme = Literal["implicit", "explicit"]


def paper(n: int, pressure: float = 80.0, p0: float = 40.0, grading: float = 1.0) -> Case:
    """Return the paper's case on n contact elements, uniform unless graded; MPa."""
    return read_case(
        CASE,
        [
            f"mesh.contact_elements={n}",
            f"mesh.grading={grading!r}",
            f"load.pressure={pressure!r}",
            f"wear.lower.p0={p0!r}",
        ],
    )


def nodal_compliances(case: Case, comm: MPI.Comm) -> FloatArray:
    """Return C of both bodies at modulus 1, (2, n, n) mm/MPa, gaps from end nodes. Collective."""
    line, found = case.line, []
    for ring in case.rings:
        boundary = boundary_mesh(case.section(ring), line, case.mesh)
        ends = boundary.elements[boundary.contact][:, [0, 2]]
        response = solve_body(
            boundary, boundary_conditions(boundary, ring.grip), ring.poisson,
            case.mesh.quadrature_tolerance, ends.ravel(), boundary.fixed, comm,
        )  # fmt: skip
        found.append(-response.displacement[:, 1].reshape(line.n, 2, line.n).mean(1))
    return np.array(found)


def pairs(case: Case, comm: MPI.Comm) -> dict[Gaps, ContactPair]:
    """Return the contact pair with either gaps. Collective."""
    right = assemble(case, comm)
    return {"mid-point": right, "nodal": replace(right, normal=nodal_compliances(case, comm))}


def softness(compliance: ContactCompliance) -> tuple[float, float, float]:
    """Return smallest and largest eigenvalue of C and its value for +-1, mm/MPa (area norm)."""
    line, matrix = compliance.line, compliance.matrix
    root = np.sqrt(line.area)
    values = np.linalg.eigvalsh(matrix / (root[:, None] * root))
    sign = (-1.0) ** np.arange(line.n)
    alternating = float(sign @ matrix @ sign / line.area.sum())
    return float(values[0]), float(values[-1]), alternating


def alternating(wear: FloatArray) -> FloatArray:
    """Return the alternating component of values on equal elements, but for two at either end."""
    return np.diff(wear, 4) / 16.0


def ripple(line: ContactLine, wear: FloatArray) -> float:
    """Return the r.m.s. alternating component of the wear away from the edges."""
    middle = 0.5 * (line.edges[0] + line.edges[-1])
    inner = np.abs(line.r[2:-2] - middle) < 0.4 * (line.edges[-1] - line.edges[0])
    return float(np.sqrt(np.mean(alternating(wear)[inner] ** 2)))


@dataclass(frozen=True)
class Run:
    """A wear history at TIMES.

    Parameters
    ----------
    r : (n,) float, mm.
    wear : (times, n) float, um.
    pressure : (n,) float, MPa, at the last time.
    penetration : um, approach since the start, at the last time.
    ripples : (times,) float, um.
    """

    r: FloatArray
    wear: FloatArray
    pressure: FloatArray
    penetration: float
    ripples: FloatArray


def worn(case: Case, pair: ContactPair, scheme: Scheme, step: float, comm: MPI.Comm) -> Run:
    """Wear a case in equal steps, s, that divide TIMES. Collective."""
    stepping = Stepping(scheme, step, round(TIMES[-1] / step))
    states: list[State] = []

    def keep(snapshot: Snapshot) -> bool:
        states.append(one(snapshot.state, 0))
        return False

    simulate_one(replace(case, time=stepping), comm, pair=pair, observers=[keep])
    profiles = [1e3 * states[round(time / step)].wear[0] for time in TIMES]
    first, last = states[0].contact, states[-1].contact
    return Run(
        pair.line.r,
        np.array(profiles),
        last.pressure,
        1e3 * (last.approach - first.approach),
        np.array([ripple(pair.line, profile) for profile in profiles]),
    )


def rate_per_pressure(case: Case) -> FloatArray:
    """Return kappa V, (n,) mm/s/MPa, of the worn body."""
    law, omega = case.wear_lower, case.load.omega
    assert isinstance(law, ThresholdLaw)
    assert isinstance(omega, float)
    return law.k * case.friction * omega * case.line.arm


def formula(case: Case) -> float:
    """Return the explicit limit 1.485 h / (E* kappa V) of a uniform mesh, s, where V is largest."""
    modulus = contact_modulus(*((ring.young, ring.poisson) for ring in case.rings))
    fastest = float(rate_per_pressure(case).max())
    return EXPLICIT_LIMIT * float(case.line.width.mean()) / modulus / fastest


def grows(
    physics: Physics, contacts: CorrectedContacts, state: State, step: float, n_steps: int = 60
) -> bool:
    """Tell whether explicit steps make a small alternating change of the wear grow. Collective.

    All being in contact and above the threshold, its growth does not depend on the state. A change
    of 0.01 MPa stays far above round-off and far below the pressure.
    """
    n = physics.line.n
    sign = (-1.0) ** np.arange(n)
    bump = np.zeros_like(state.wear)
    bump[0, 0] = 1e-2 * (physics.compliances.every[0].matrix @ sign) / physics.area
    wear = state.wear + bump
    contact = contacts.solve(physics.contact_inputs(state.time, wear), state.contact.pressure)
    rates = physics.rates_at(state.time, wear, contact.pressure)
    changed = replace(state, wear=wear, contact=contact, rates=rates)
    sizes = []
    for _ in range(n_steps):
        end = state.time + step
        state = forward(physics, contacts, state, end).state
        changed = forward(physics, contacts, changed, end).state
        # the pressure, because a force forgets an even change of the profile
        sizes.append(float(np.linalg.norm(changed.contact.pressure - state.contact.pressure)))
        if sizes[-1] > 1.0 * math.sqrt(n):  # before contact is lost
            return True
    return sizes[-1] > sizes[-6]


def measured_limit(pair: ContactPair, case: Case, guess: float, comm: MPI.Comm) -> float:
    """Return the largest step, s, at which explicit stepping damps a change of wear. Collective.

    By bisection to 0.2 %, from a worn state with all in contact; p0 = 0.
    """
    physics = Physics.of([case], pair)
    with physics.contacts() as contacts:
        state = initial_state(physics, contacts)
        for end in (100.0, 200.0, 300.0):  # until pressures hardly change
            state = backward(physics, contacts, state, np.array([end])).state
        low = high = guess
        while grows(physics, contacts, state, low):
            low, high = 0.5 * low, low
        while not grows(physics, contacts, state, high):
            low, high = high, 2.0 * high
        while high > 1.002 * low:
            step = math.sqrt(low * high)
            low, high = (low, step) if grows(physics, contacts, state, step) else (step, high)
    return math.sqrt(low * high)


@dataclass(frozen=True)
class Limits:
    """Largest stable explicit steps on a uniform mesh, s, and eigenvalues of C.

    Parameters
    ----------
    formula : for mid-point gaps.
    measured, eigenvalue : from stepping, and from lambda_max(W C^-1), of either gaps.
    softness : as the function of that name has it, of either gaps.
    """

    formula: float
    measured: dict[Gaps, float]
    eigenvalue: dict[Gaps, float]
    softness: dict[Gaps, tuple[float, float, float]]


def limits(n: int, comm: MPI.Comm) -> Limits:
    """Return the largest stable explicit steps on n elements. Collective."""
    case = paper(n, p0=0.0)
    both, guess, rate = pairs(case, comm), formula(case), rate_per_pressure(case)
    compliances = {gaps: pair.compliance(young(case)) for gaps, pair in both.items()}
    return Limits(
        guess,
        {gaps: measured_limit(pair, case, guess, comm) for gaps, pair in both.items()},
        {gaps: largest_stable_step(each, rate) for gaps, each in compliances.items()},
        {gaps: softness(each) for gaps, each in compliances.items()},
    )


def unworn(pair: ContactPair, case: Case, comm: MPI.Comm) -> FloatArray:
    """Return the pressure before any wear, (n,) MPa. Collective."""
    physics = Physics.of([case], pair)
    with physics.contacts() as contacts:
        return initial_state(physics, contacts).contact.pressure[0]


def bilateral(case: Case, weighted: FloatArray) -> FloatArray:
    """Return the pressure of full contact, tension allowed, (n,) MPa, for diag(m) C or its sym."""
    area, force = case.line.area, case.load.force
    assert isinstance(force, float)
    p = np.linalg.solve(weighted, area)
    return p * (force / float(area @ p))


#: columns of unworn pressures at 29 mm: gaps, and how solved
P29_COLUMNS = (
    "mid-point", "nodal, p >= 0", "nodal, tension allowed", "the same, C as collocated"
)  # fmt: skip


def pressures_at_29(n: int, grading: float, comm: MPI.Comm) -> list[float]:
    """Return p(29), MPa, at 50 MPa mean pressure, for P29_COLUMNS. Collective."""
    case = paper(n, pressure=50.0, grading=grading)
    both = pairs(case, comm)
    nodal = both["nodal"]
    lower, upper = (each / e for each, e in zip(nodal.normal, young(case), strict=True))
    profiles = [
        unworn(both["mid-point"], case, comm),
        unworn(nodal, case, comm),
        bilateral(case, nodal.compliance(young(case)).matrix),
        bilateral(case, case.line.area[:, None] * (lower + upper)),
    ]
    return [float(np.interp(29.0, case.line.r, p)) for p in profiles]


@dataclass(frozen=True)
class Study:
    """All that is drawn and printed.

    Parameters
    ----------
    runs : by (gaps, scheme, step in s, p0 in MPa), at N elements.
    unworn : (n,) float, MPa, of either gaps at N elements.
    limits : by number of elements.
    """

    runs: dict[tuple[Gaps, Scheme, float, float], Run]
    unworn: dict[Gaps, FloatArray]
    limits: dict[int, Limits]


#: runs of both thresholds
RUNS: tuple[tuple[Gaps, Scheme, float], ...] = (
    ("mid-point", "implicit", LONG),
    ("mid-point", "implicit", READING),
    ("mid-point", "explicit", LONG),
    ("mid-point", "explicit", SHORT),
    ("mid-point", "explicit", READING),
    ("nodal", "explicit", SHORT),
    ("nodal", "explicit", READING),
    ("nodal", "explicit", 0.04),
    ("nodal", "implicit", LONG),
    ("nodal", "implicit", READING),
)


def study(comm: MPI.Comm) -> Study:
    """Make all runs. Collective."""
    case = paper(N)
    both = pairs(case, comm)
    return Study(
        {
            (gaps, scheme, step, p0): worn(paper(N, p0=p0), both[gaps], scheme, step, comm)
            for gaps, scheme, step in RUNS
            for p0 in (0.0, 40.0)
        },
        {gaps: unworn(pair, case, comm) for gaps, pair in both.items()},
        {n: limits(n, comm) for n in SIZES},
    )


def report(found: Study) -> None:
    """Print the numbers."""
    print(
        f"{N} equal elements, 80 MPa (our reading), after {TIMES[-1]:g} s: ripple, penetration (um)"
    )
    print(f"{'gaps':<11}{'scheme':<10}{'step (s)':>8} | {'p0 = 0':^29} | {'p0 = 40 MPa':^29}")
    head = f"{'ripple':>8}{'penetr.':>9}{'p (MPa)':>12}"
    print(f"{'':<29} | {head} | {head}")
    for gaps, scheme, step in RUNS:
        cells = []
        for p0 in (0.0, 40.0):
            run = found.runs[gaps, scheme, step, p0]
            p = f"{run.pressure.min():.0f}..{run.pressure.max():.0f}"
            cells.append(f"{run.ripples[-1]:>8.5f}{run.penetration:>9.3f}{p:>12}")
        print(f"{gaps:<11}{scheme:<10}{step:>8.3g} | {cells[0]} | {cells[1]}")
    print("\nlargest stable explicit step (s)")
    print(
        f"{'n':>4} {'gaps':<10}{'measured':>10}{'eigenvalue':>11}{'formula':>9}{'ratio':>8}", end=""
    )
    print("   eigenvalues of C (mm/MPa): smallest, largest / smallest, of +-1")
    for n, limit in found.limits.items():
        for gaps, step in limit.measured.items():
            least, most, sign = limit.softness[gaps]
            print(
                f"{n:>4} {gaps:<10}{step:>10.4g}{limit.eigenvalue[gaps]:>11.4g}"
                f"{limit.formula:>9.4g}{step / limit.formula:>8.4f}{least:>12.3e}"
                f"{most / least:>10.3g}{sign:>11.3e}"
            )


def report_unworn(sizes: tuple[int, ...], comm: MPI.Comm) -> None:
    """Print unworn pressures at 29 mm. Collective."""
    lines = [
        (grading, n, pressures_at_29(n, grading, comm)) for grading in (1.0, 2.5) for n in sizes
    ]
    if comm.rank > 0:
        return
    print(f"\np(29 mm) unworn at 50 MPa (MPa; true {P29})")
    print(f"{'grading':>7}{'n':>5}" + "".join(f"{name:>27}" for name in P29_COLUMNS))
    for grading, n, values in lines:
        print(f"{grading:>7g}{n:>5}" + "".join(f"{value:>27.2f}" for value in values))


_DASHES = ((0, (1, 1)), "-.", "--", "-")
#: of what the panels show: (a), (b) and nodal gaps, (c) and mid-point gaps
_SHOWN = {"a": COLOURS[1], "b": COLOURS[3], "c": COLOURS[0]}


def draw(found: Study, path: Path) -> None:
    """Draw the picture. On one rank."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.6, 6.9), layout="constrained")
        axes = figure.subplots(2, 3)
        limit = found.limits[N].eigenvalue
        times = LONG / limit["mid-point"], SHORT / limit["nodal"]
        panels: dict[str, tuple[Run, str]] = {
            "a": (
                found.runs["mid-point", "explicit", LONG, 40.0],
                f"explicit, mid-point gaps, steps of {LONG:.1f} s:\n"
                f"{times[0]:.1f} times the stable step of {limit['mid-point']:.1f} s",
            ),
            "b": (
                found.runs["nodal", "explicit", SHORT, 40.0],
                f"explicit, nodal gaps, steps of {SHORT:g} s: stable with\n"
                f"mid-point gaps, {times[1]:.0f} times the limit of nodal ones",
            ),
            "c": (
                found.runs["mid-point", "implicit", LONG, 40.0],
                f"implicit, mid-point gaps, steps of {LONG:.1f} s:\n"
                "no ripple (dots, 200 s: nor with nodal gaps)",
            ),
        }
        sames = (
            found.runs["mid-point", "explicit", LONG, 0.0],
            found.runs["nodal", "explicit", SHORT, 0.0],
            found.runs["mid-point", "implicit", LONG, 0.0],
        )
        for ax, same, (name, (run, title)) in zip(axes[0], sames, panels.items(), strict=True):
            _profiles(ax, run, same, _SHOWN[name])
            ax.set_title(f"({name}) {title}", loc="left")
        nodal = found.runs["nodal", "implicit", LONG, 40.0]
        axes[0, 2].plot(nodal.r[::2], -nodal.wear[-1, ::2], ".", ms=4, color=_SHOWN["b"])
        _pressures(axes[1, 0], panels)
        _unworn(axes[1, 1], nodal.r, found.unworn)
        _limits(axes[1, 2], found.limits)
        figure.suptitle(
            f"Why late worn profiles ripple: the paper's rings, p0 = 40 MPa, {N} equal contact "
            "elements (load and speed are our reading: 80 MPa, 3.54 rad/s)",
            fontsize=10.0,
        )
        figure.savefig(path)


def _profiles(ax: Axes, run: Run, same: Run, colour: str) -> None:
    """Draw worn profiles, and in words what happened, also where p0 = 0 (``same``)."""
    for time, profile, dashes in zip(TIMES, run.wear, _DASHES, strict=True):
        ax.plot(run.r, -profile, linestyle=dashes, color=colour, label=f"{time:g} s")
    ax.set(xlabel="distance to axis (mm)", ylabel="height of worn face (µm)", ylim=(-25.0, 0.0))
    ax.text(
        0.5, 0.14, f"200 s: ripple {run.ripples[-1]:.1g} µm,\n"
        f"penetration {run.penetration:.1f} µm (p0 = 0: {same.penetration:.1f} µm)",
        transform=ax.transAxes, ha="center", fontsize=8.0,
    )  # fmt: skip
    ax.legend(
        frameon=False, ncols=4, loc="lower center", handlelength=2.2, columnspacing=0.8,
        handletextpad=0.4, fontsize=7.5, borderaxespad=0.1,
    )  # fmt: skip


def _pressures(ax: Axes, panels: dict[str, tuple[Run, str]]) -> None:
    styles = {"a": ("o-", 1.4, 3), "b": (".:", 0.8, 2), "c": ("-", 1.6, 4)}
    for name, (run, _) in panels.items():
        mark, width, order = styles[name]
        ax.plot(
            run.r, run.pressure, mark, ms=3.5, lw=width, zorder=order, color=_SHOWN[name],
            label=f"({name})",
        )  # fmt: skip
    highest = max(float(run.pressure.max()) for run, _ in panels.values())
    top = 1.2 * highest  # room for the legend
    ax.set(xlabel="distance to axis (mm)", ylabel="contact pressure (MPa)", ylim=(-5.0, top))
    ax.set_title(f"(d) contact pressure after {TIMES[-1]:g} s of (a), (b), (c)", loc="left")
    ax.legend(frameon=False, ncols=3, loc="upper center")


def _unworn(ax: Axes, r: FloatArray, pressures: dict[Gaps, FloatArray]) -> None:
    names: tuple[tuple[Gaps, str], ...] = (("nodal", "b"), ("mid-point", "c"))
    for gaps, name in names:
        ax.plot(r, pressures[gaps], ".-", ms=4, color=_SHOWN[name], label=f"{gaps} gaps")
    ax.set(xlabel="distance to axis (mm)", ylabel="contact pressure (MPa)")
    ax.set_title(
        "(e) contact pressure before any wear: nodal gaps\nhardly feel alternating pressures",
        loc="left",
    )
    ax.legend(frameon=False, loc="upper center")


def _limits(ax: Axes, limit: dict[int, Limits]) -> None:
    n = np.array(list(limit))
    fine = np.geomspace(n[0], n[-1], 50)
    first = limit[n[0]]
    ax.loglog(
        fine, first.formula * n[0] / fine, "-", color="0.3", lw=1.0,
        label="wear per step 1.485 h p / E*",
    )  # fmt: skip
    cubic = first.eigenvalue["nodal"] * (n[0] / fine) ** 3
    ax.loglog(fine, cubic, ":", color="0.3", lw=1.0, label="as h³")
    names: tuple[tuple[Gaps, str], ...] = (("mid-point", "c"), ("nodal", "b"))
    for gaps, name in names:
        measured = [at.measured[gaps] for at in limit.values()]
        values = [at.eigenvalue[gaps] for at in limit.values()]
        style = {"ls": "none", "color": _SHOWN[name]}
        ax.loglog(
            n, measured, marker="o", ms=7, mfc="none", label=f"{gaps} gaps, by stepping", **style
        )
        ax.loglog(n, values, marker="x", ms=4, label=f"{gaps} gaps, eigenvalue", **style)
    for number, at in limit.items():
        ax.annotate(
            f"{at.measured['mid-point'] / at.formula:.3f}", (number, at.measured["mid-point"]),
            xytext=(14, 6), textcoords="offset points", ha="center", fontsize=7.5,
            color=_SHOWN["c"],
        )  # fmt: skip
    for name, step, offset in (("a", LONG, (-20, 1)), ("b", SHORT, (-20, -9))):
        ax.plot(N, step, "*", ms=7, color=_SHOWN[name], zorder=5)
        ax.annotate(f"({name})", (N, step), xytext=offset, textcoords="offset points")
    ax.set(
        xlabel="number of equal contact elements", ylabel="explicit step (s)",
        xlim=(13.5, 165.0), ylim=(2e-6, 1e2),
    )  # fmt: skip
    ax.set_xticks(n, [str(value) for value in n])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_title(
        "(f) largest stable explicit step (numbers: by\n"
        "stepping / formula) and the steps of (a), (b)",
        loc="left",
    )
    ax.legend(frameon=False, loc="lower left", fontsize=7.5, labelspacing=0.25)


def main() -> int:
    """Make all runs, print and draw them, return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/step_stability.png"))
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    try:
        found = study(comm)
        if comm.rank == 0:
            report(found)
        report_unworn((32, 64, 128), comm)
    except RingwearError as error:
        if comm.rank == 0:
            print(error, file=sys.stderr)
        return error.exit_status
    if comm.rank == 0:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        draw(found, args.output)
        print(f"\n{args.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
