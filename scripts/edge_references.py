"""Fine solutions of rings with all sorts of edges, for ``ringwear verify``.

Usage: python scripts/edge_references.py [--write] [--table]

Solves the pairs of rings of ``verification/fine.py`` on 512 contact elements of grading 3, with the
collocated compliance as it is (not made symmetric), without TAO and without time steps, and holds
them against independent finite elements and against 384 elements. Fails where they differ by more
than is allowed. ``--write`` stores them for ``verify``. ``--table`` prints how far from an edge
pressures of the package's own solution are how good, and its wear after 200 s: with the default
tolerance of time steps, and with one so small that only the mesh is left.
"""

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.linalg import lu_factor, lu_solve

import ringwear_par.verification as package
from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.errors import ComputationError
from ringwear_par.history.elastic.bodies import young
from ringwear_par.history.observers.trace import trace
from ringwear_par.verification import reference
from ringwear_par.verification.faces import (
    INSIDE,
    cone_errors,
    errors_against,
    finite_element_errors,
    from_edge,
    pressure_errors,
)
from ringwear_par.verification.fine import (
    NAME,
    RINGS,
    SORTS,
    SPEED,
    TIMES,
    FineSolution,
    K,
    Pairs,
    ring_case,
)

FINE, SECOND = Mesh(512, grading=3.0), Mesh(384, grading=3.0)
FILE = Path(package.__file__).parent / NAME
#: largest differences allowed: to finite elements, and between the two meshes (wear in mm)
TO_FINITE_ELEMENTS = {"approach": 1e-5, "ring means": 1e-3, "p(30)": 2e-4, "p(r)": 1e-3}
BETWEEN_MESHES = {"approach": 2e-6, "pressure": 1e-2, "inside": 1e-4, "wear": 2e-7}
#: distances, of pressures within these of the fine solution
WITHIN = (5e-2, 1e-2, 1e-3)


def unworn(case: Case, matrix: FloatArray) -> tuple[FloatArray, float]:
    """Return pressure (MPa) and approach (mm) under the force of a case, with lift-off.

    Parameters
    ----------
    matrix : (n, n) float, mm/MPa, compliance C.
    """
    m, touching = case.line.area, np.ones(case.line.n, dtype=bool)
    for _ in range(100):
        p, i = np.zeros_like(m), np.flatnonzero(touching)
        p[i] = np.linalg.solve(matrix[np.ix_(i, i)], np.ones(len(i)))
        approach = case.load.force / (m @ p)
        p *= approach
        now = np.where(touching, p > 0.0, matrix @ p < approach)
        if (now == touching).all():
            return p, float(approach)
        touching = now
    raise ComputationError("elements in contact were not found")


def fine_solution(case: Case, matrix: FloatArray, obliquity: FloatArray) -> FineSolution:
    """Return the unworn contact and, of rings in full contact with p0 = 0, the worn profiles.

    C p = delta - w and m p = F give p = p_0 - R w, and with the rates s p of wear w' = s p_0 - B w
    with B = s R: a sum of exponentials of its eigenvalues, one of which is zero.

    Parameters
    ----------
    matrix : (n, n) float, mm/MPa, compliance C.
    obliquity : (n,) float, 1 / cos alpha of the faces.
    """
    line = case.line
    p, approach = unworn(case, matrix)
    if not p.all():
        return FineSolution(case.mesh, approach, p, {})
    m, s = line.area, K * case.friction * SPEED * line.arm * obliquity
    factor = lu_factor(matrix)
    flat, across = lu_solve(factor, np.ones_like(m)), lu_solve(factor, m, trans=1)
    response = lu_solve(factor, np.eye(line.n)) - np.outer(flat, across) / (m @ flat)
    # scaled such that a symmetric diag(m) C would make it symmetric
    scale = np.sqrt(s / m)
    rates, modes = np.linalg.eig((s / scale)[:, None] * response * scale)
    shares = np.linalg.solve(modes, s * p / scale)
    rates[np.argmin(np.abs(rates))] = 0.0  # the mean depth, which nothing evens out

    def worn(time: float) -> FloatArray:
        grown = np.full_like(rates, time)
        np.divide(-np.expm1(-rates * time), rates, out=grown, where=rates != 0.0)
        return scale * (modes @ (grown * shares)).real

    for time in np.geomspace(1e-4, TIMES[-1], 20):
        pressure = scale * (modes @ (np.exp(-rates * time) * shares)).real / s
        if not (pressure > 0.0).all():
            raise ComputationError(f"{time:g} s: elements have lost contact")
    return FineSolution(case.mesh, approach, p, {time: worn(time) for time in TIMES})


def fine_solutions(mesh: Mesh, names: Iterable[str] = SORTS) -> dict[str, FineSolution]:
    """Return the solutions of some of SORTS on a mesh."""
    pairs, found = Pairs(MPI.COMM_SELF), {}
    for name in names:
        case = ring_case(SORTS[name], mesh)
        compliance = pairs.of(case).compliance(young(case))
        found[name] = fine_solution(case, compliance.collocated, compliance.obliquity)
    return found


def differences(one: FineSolution, other: FineSolution) -> dict[str, float]:
    """Return by how much two solutions differ on the rings that are stored, see ``fine.digits``."""
    one, other = one.on(RINGS), other.on(RINGS)
    off = pressure_errors(one.pressure, other)
    return {
        "approach": abs(one.approach / other.approach - 1.0),
        "pressure": float(off.max()),
        "inside": float(off[from_edge(one.line) > INSIDE].max()),
        "wear": float(
            max((np.abs(one.wear[t] - other.wear[t]).max() for t in one.wear), default=0)
        ),
    }


def told(found: dict[str, float], allowed: dict[str, float]) -> str:
    """Return differences as text; what is more than allowed stands in exclamation marks."""
    parts = []
    for name, value in found.items():
        over = not value <= allowed[name]
        parts.append(f"{'!' if over else ''}{name} {value:.1e}{'!' if over else ''}")
    return ", ".join(parts)


def _rounded(value: float, digits: str) -> float:
    return float(format(value, digits))


def write(fine: dict[str, FineSolution], accuracy: dict[str, dict[str, float]]) -> None:
    """Store solutions for ``verify``: pressures to seven digits, wear to a picometre."""
    stored = {}
    for name, solution in fine.items():
        means = solution.on(RINGS)
        stored[name] = {
            "approach_mm": _rounded(means.approach, ".8g"),
            "pressure_mpa": [_rounded(p, ".7g") for p in means.pressure],
            "wear_um": {
                f"{time:g}": [_rounded(1e3 * w, ".6f") for w in depths]
                for time, depths in means.wear.items()
            },
            "digits": {key: _rounded(value, ".1e") for key, value in accuracy[name].items()},
        }
    lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in stored.items()]
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def from_where(fine: FineSolution, pressure: FloatArray, most: float) -> float:
    """Return the distance from an edge (mm) from which on all pressures are within an error."""
    distance = from_edge(fine.line)
    return float(distance[pressure_errors(pressure, fine) > most].max(initial=0.0))


def table(fine: dict[str, FineSolution], sizes: Sequence[int] = (32, 64, 128, 256)) -> str:
    """Return how good the package's solutions are, by the distance from an edge, as Markdown."""
    pairs = Pairs(MPI.COMM_SELF)
    rows = [
        "| edges | elements | outermost, um | worst element | 5 % from, um | 1 % from, um "
        "| 0.1 % from, um | approach | wear 200 s, um | with fine steps, um |",
        "|" + "---|" * 10,
    ]
    for name, solution in fine.items():
        if not solution.wear:
            continue
        for n in sizes:
            mesh = Mesh(n)
            case = ring_case(SORTS[name], mesh)
            exact = solution.on(mesh)
            history = trace(case, MPI.COMM_SELF, pair=pairs.of(case))
            errors = errors_against(exact, history)
            small = replace(case, time=replace(case.time, tolerance=1e-9))
            worn = trace(small, MPI.COMM_SELF, pair=pairs.of(case)).last.wear[0]
            off = float(np.abs(worn - exact.wear[TIMES[-1]]).max())
            p = history.states[0].contact.pressure
            reached = [1e3 * from_where(exact, p, most) for most in WITHIN]
            cells = [
                name, str(n), f"{1e3 * exact.line.width.min():.2g}", f"{errors['pressure']:.1e}",
                *(f"{x:.2g}" for x in reached), f"{errors['approach']:.1e}",
                f"{1e3 * errors['wear 200']:.1e}", f"{1e3 * off:.1e}",
            ]  # fmt: skip
            rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"store them in {NAME}")
    parser.add_argument("--table", action="store_true", help="print pressures by distance")
    args = parser.parse_args()
    fine, second = fine_solutions(FINE), fine_solutions(SECOND)
    report, accuracy = [], {}
    for name, solution in fine.items():
        accuracy[name] = differences(second[name], solution)
        report.append(
            f"{name}, {SECOND.contact_elements} elements: {told(accuracy[name], BETWEEN_MESHES)}"
        )
        found: dict[str, float] = {}
        if name in reference.EDGE_APPROACH:
            found = finite_element_errors(name, solution.mesh, solution.pressure, solution.approach)
        elif name == "cones of 1 degree":
            found = cone_errors(1.0, solution.line, solution.pressure, solution.approach)
        elif name == "paper":
            found = {"approach": abs(solution.approach / reference.PAPER_APPROACH - 1.0)}
        if found:
            report.append(f"{name}, finite elements: {told(found, TO_FINITE_ELEMENTS)}")
    print("\n".join(report), flush=True)
    if "!" in "".join(report):
        print("not all are as near as they must be: see !", file=sys.stderr)
        return 1
    if args.write:
        write(fine, accuracy)
    if args.table:
        print(table(fine))
    return 0


if __name__ == "__main__":
    sys.exit(main())
