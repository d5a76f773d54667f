"""Does it matter that the boundary moves as it wears? The paper's rings, fixed and updated.

    python scripts/follow_the_wear.py [-o FIG.png]

The paper moves the boundary with the wear; by default the mesh stays here and the worn profile
enters through the gap alone. Both are computed with p0 = 0, and what differs is shown over time,
with what it costs. Load and speed are our reading of the paper.
"""

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Stepping
from ringwear_par.elasticity.bem.assembly import load_kernels
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.observers.trace import Trace
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.pictures.style import COLOURS, DASHES
from ringwear_par.verification.histories import paper_case

TOLERANCES = (0.005, 0.002, 0.001)  # mm
_STEPPING = Stepping("implicit", 1.0, 200)
#: elements at either edge that are not called the interior: a tenth of the contact's width each
_EDGE = 0.1


@dataclass(frozen=True)
class Compared:
    """A history: per step time (s), approach (mm), pressure (n,), deepest wear (mm); and its cost.

    Parameters
    ----------
    seconds : wall seconds of the steps, re-assemblies included.
    assemblies : number of re-assemblies.
    """

    time: FloatArray
    approach: FloatArray
    pressure: FloatArray
    wear: FloatArray
    seconds: float
    assemblies: int


class Clock:
    """Observer that notes when states are shown to it, by time.perf_counter."""

    def __init__(self) -> None:
        self.shown: list[float] = []

    def __call__(self, snapshot: Snapshot) -> bool:
        """Note the time."""
        self.shown.append(time.perf_counter())
        return False


def history(case: Case) -> Compared:
    """Run a case and keep what is compared; its clock starts with the contact before any wear."""
    seen, clock = Trace(), Clock()
    simulate_one(case, MPI.COMM_SELF, observers=[seen, clock])
    states = seen.states
    return Compared(
        np.array([s.time for s in states]),
        np.array([s.contact.approach for s in states]),
        np.array([s.contact.pressure for s in states]),
        np.array([s.wear[0].max() for s in states]),
        clock.shown[-1] - clock.shown[0],
        seen.physics.updates,
    )


def interior(case: Case) -> FloatArray:
    """Return which elements are not near an edge of the contact, (n,) bool."""
    inner, outer = case.contact
    margin = _EDGE * (outer - inner)
    return (case.line.r > inner + margin) & (case.line.r < outer - margin)


def compare() -> tuple[Case, Compared, dict[float, Compared]]:
    """Run the fixed and the updated histories."""
    load_kernels(MPI.COMM_SELF)
    case = paper_case(Mesh(), p0=(0.0, None), stepping=_STEPPING)
    history(replace(case, time=replace(_STEPPING, steps=3)))  # so that the first is not the slowest
    fixed = history(case)
    updated = {
        tolerance: history(
            replace(case, mesh=Mesh(geometry="updated", geometry_tolerance=tolerance))
        )
        for tolerance in TOLERANCES
    }
    return case, fixed, updated


def main() -> None:
    """Print the comparison, and draw it where asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, metavar="FIG.png")
    output = parser.parse_args().output
    case, fixed, updated = compare()
    inside = interior(case)
    print("updated against fixed after 200 s (24 um of wear), p0 = 0:")
    print("tolerance  re-assemblies  approach      interior pressure  steps' wall time")
    for tolerance, other in updated.items():
        approach = 1e3 * (other.approach - fixed.approach)[-1]
        pressure = np.abs(other.pressure / fixed.pressure - 1.0)[:, inside].max(axis=1)
        print(
            f"{1e3 * tolerance:6.0f} um  {other.assemblies:13d}  {approach:+9.4f} um  "
            f"{1e2 * pressure[-1]:15.4f} %  {other.seconds:8.3f} s = "
            f"{other.seconds / fixed.seconds:.1f} x fixed"
        )
    if output is None:
        return
    figure = Figure(figsize=(7.4, 3.1), layout="constrained")
    left, right = figure.subplots(1, 2)
    for number, (tolerance, other) in enumerate(updated.items()):
        style = {"color": COLOURS[number], "linestyle": DASHES[number]}
        label = f"tolerance {1e3 * tolerance:g} \N{MICRO SIGN}m, {other.assemblies} assemblies"
        left.plot(other.time, 1e3 * (other.approach - fixed.approach), label=label, **style)
        pressure = np.abs(other.pressure / fixed.pressure - 1.0)[:, inside].max(axis=1)
        right.plot(other.time, 1e2 * pressure, label=label, **style)
    left.set_ylabel("approach, updated \N{MINUS SIGN} fixed (\N{MICRO SIGN}m)")
    right.set_ylabel("change of interior pressure (%)")
    for axes in (left, right):
        axes.set_xlabel("time (s)")
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_xlim(left=0.0)
    left.legend(frameon=False, fontsize=8)
    figure.suptitle(
        "The paper's rings with elements that follow the wear, against a fixed mesh "
        f"(p0 = 0, wear to {1e3 * fixed.wear[-1]:.0f} \N{MICRO SIGN}m; load and speed are our "
        "reading)",
        fontsize=8,
    )
    figure.savefig(output, dpi=200)


if __name__ == "__main__":
    main()
