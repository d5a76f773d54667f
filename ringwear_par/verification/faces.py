"""Contact faces: edges of singular and of regular pressure, and matched cones, unworn and worn."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Stepping
from ringwear_par.elasticity.bem.body import boundary_conditions, solve_body
from ringwear_par.elasticity.bem.boundary import boundary_mesh
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.mesh import ContactLine, Mesh, contact_line
from ringwear_par.elasticity.sections import Body
from ringwear_par.history.elastic.bodies import bodies, young
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.observers.trace import Trace, trace
from ringwear_par.history.start import first_contact
from ringwear_par.verification import reference
from ringwear_par.verification.check import NU, SIZES, Check, checks_of, identity
from ringwear_par.verification.fine import (
    CONTACT,
    FORCE,
    SORTS,
    SPEED,
    TIMES,
    FineSolution,
    Pairs,
    Rings,
    digits,
    ring_case,
    ring_means,
    stored,
)
from ringwear_par.verification.half_space import pressure_at

#: beyond this distance from an edge, mm, the shape of the pressure at the edge is resolved
INSIDE = 0.02
#: long steps, to the steady state
_STEADY = Stepping("implicit", 1000.0, 8)
#: specific wear rates of both bodies, 1/MPa, where both wear
BOTH = (1e-7, 3e-7)


def from_edge(line: ContactLine) -> FloatArray:
    """Return the distances of the elements from the nearer edge, mm."""
    return np.minimum(line.r - line.edges[0], line.edges[-1] - line.r)


def pressure_errors(pressure: FloatArray, fine: FineSolution) -> FloatArray:
    """Return relative errors of pressures on the elements of a fine solution.

    Where faces lift off, pressures below the mean one are compared in units of that.
    """
    size = fine.pressure
    if not fine.wear:
        size = np.maximum(size, fine.line.area @ size / fine.line.area.sum())
    return np.abs(pressure - fine.pressure) / size


def errors_against(fine: FineSolution, history: Trace) -> dict[str, float]:
    """Return the errors of a history against a fine solution on the elements of the history.

    Returns
    -------
    Relative: ``approach``, ``pressure`` (worst element), ``inside`` (worst from INSIDE on), all
    unworn. In mm: ``wear 1``, ``wear 10``, ``wear 200`` (worst element, by time in s). ``open``:
    number of elements without pressure, of all states together. No wear where faces lift off.
    """
    first, line = history.states[0].contact, history.physics.line
    off = pressure_errors(first.pressure, fine)
    return {
        "approach": abs(first.approach / fine.approach - 1.0),
        "pressure": float(off.max()),
        "inside": float(off[from_edge(line) > INSIDE].max()),
        "open": float(sum((s.contact.pressure <= 0.0).sum() for s in history.states)),
        **{
            f"wear {time:g}": float(np.abs(history.at(time).wear[0] - wear).max())
            for time, wear in fine.wear.items()
        },
    }


def finite_element_errors(
    name: str, mesh: Mesh, pressure: FloatArray, approach: float
) -> dict[str, float]:
    """Return relative errors against finite elements: ``approach``, ``ring means``, ``p(30)``.

    The pressure (n,) MPa is on the contact elements of a mesh.
    """
    ring_values: list[float] = []
    exact: list[float] = []
    distances = np.array(reference.EDGE_DISTANCES)
    inner, outer = reference.EDGE_PRESSURE[name]
    for radii, means in (
        (CONTACT[0] + distances, inner),
        (CONTACT[1] - distances[::-1], outer[::-1]),
    ):
        ring_values.extend(ring_means(mesh, pressure, radii))
        exact.extend(means)
    line = contact_line(CONTACT, mesh)
    return {
        "approach": abs(approach / reference.EDGE_APPROACH[name] - 1.0),
        "ring means": float(np.abs(np.array(ring_values) / exact - 1.0).max()),
        "p(30)": abs(pressure_at(line, pressure, 30.0) / reference.EDGE_MIDDLE[name] - 1.0),
    }


#: checks of a history: error, text, the largest error allowed at 128 elements, key of digits
ROWS = (
    ("approach", "approach", 1e-5, "approach"),
    ("pressure", "pressure, worst of all elements", 8e-2, "pressure"),
    ("inside", "pressure, worst from 0.02 mm on", 5e-3, "inside"),
    *((f"wear {t:g}", f"wear after {t:g} s, worst element, mm", 1e-5, "wear") for t in TIMES),
)
#: faces whose pressure is regular up to the edge, and the largest error of any element there
_REGULAR, _REGULAR_ERROR = ("flush", "flush, equal moduli"), 1e-4


def rows_against(
    name: str, fine: Sequence[FineSolution], histories: Sequence[Trace]
) -> Iterator[Check]:
    """Return the checks of histories at SIZES against a stored solution."""
    errors = [errors_against(f, h) for f, h in zip(fine, histories, strict=True)]
    lifts = not fine[0].wear
    for key, text, tolerance, accuracy in ROWS:
        if key not in errors[0]:
            continue
        if name in _REGULAR and accuracy in ("pressure", "inside"):
            tolerance = _REGULAR_ERROR
        if lifts and accuracy in ("pressure", "inside"):
            text += ", of >= 50 MPa"
        yield Check(f"{name}: {text}", SIZES, tuple(error[key] for error in errors), tolerance,
                    digits(name)[accuracy])  # fmt: skip
    if not lifts:
        yield Check(f"{name}: elements without pressure", SIZES,
                    tuple(error["open"] for error in errors), 0.0, kind="bound")  # fmt: skip


def edge_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare flat rings with fine solutions and with finite elements. Collective on comm."""
    pairs = Pairs(comm)

    def pair_of(rings: Rings, n: int) -> ContactPair:
        return pairs.of(ring_case(rings, Mesh(n)))

    for name, rings in SORTS.items():
        if rings.degrees:
            continue
        histories = [trace(ring_case(rings, Mesh(n)), comm, pair=pair_of(rings, n)) for n in SIZES]
        yield from rows_against(name, [stored(name).on(Mesh(n)) for n in SIZES], histories)
        if name in reference.EDGE_APPROACH:
            yield from _finite_element_rows(name, histories)
        if name == "soft on stiff":
            yield from steady_rows(name, rings, [pair_of(rings, n) for n in SIZES], comm)
            yield from both_wear(name, rings, pair_of(rings, 64), comm)


def _finite_element_rows(name: str, histories: Iterable[Trace]) -> Iterator[Check]:
    errors = [
        finite_element_errors(name, Mesh(n), first.pressure, first.approach)
        for n, first in ((h.physics.line.n, h.states[0].contact) for h in histories)
    ]
    rows = (
        (f"{name}, finite elements: approach", 3e-5, 1e-6),
        (f"{name}, finite elements: ring means", 5e-3, 2e-4),
        (f"{name}, finite elements: p(30)", 1e-3, 1e-4),
    )
    yield from checks_of([list(error.values()) for error in errors], rows)


def both_wear(name: str, rings: Rings, pair: ContactPair, comm: MPI.Comm) -> Iterator[Check]:
    """Check the balances of both bodies' wear in adaptive histories. Collective on comm."""
    n = pair.line.n
    history = trace(ring_case(rings, Mesh(n), k=BOTH), comm, pair=pair)
    worst, states = history.balances, history.states[1:]
    label, split = f"{name}, both wear", 0.0
    for lower, upper in (state.wear for state in states):
        off = np.abs(upper * BOTH[0] / BOTH[1] - lower)
        split = max(split, float((off / np.maximum(lower, np.finfo(float).tiny)).max()))
    yield identity(f"{label}: worn volumes = k1, k2 x energy, all steps", n, worst.energy, 1e-12)
    yield identity(f"{label}: depths split k1 : k2, all steps", n, split, 1e-12)
    yield identity(f"{label}: volume balance, all steps", n, worst.volume, 1e-12)
    yield identity(f"{label}: force balance, all steps", n, worst.force, 1e-12)


def steady_rows(
    name: str, rings: Rings, pairs: Sequence[ContactPair], comm: MPI.Comm
) -> Iterator[Check]:
    """Compare the steady state of both bodies' wear with what is known of it. Collective on comm.

    The vertical rate k mu p omega r / cos alpha is uniform, so that p = c / r as on flat faces.
    The approach rate is mu (k1 + k2) omega c / cos alpha, the torque mu c times the contact area
    over cos alpha.
    """
    c = reference.steady_constant(FORCE, 0.0, *CONTACT)
    a, b = CONTACT
    errors = []
    for pair in pairs:
        case = ring_case(rings, Mesh(pair.line.n), _STEADY, BOTH)
        history = trace(case, comm, pair=pair)
        before, last = (state.contact for state in history.states[-2:])
        rate = (last.approach - before.approach) / _STEADY.step
        torque = float(history.physics.torque(last.pressure)[0])
        oblique = case.friction_at(0.0) * c / math.cos(math.radians(rings.degrees))
        errors.append(
            (
                float(np.abs(last.pressure * pair.line.arm / c - 1.0).max()),
                abs(rate / (oblique * sum(BOTH) * SPEED) - 1.0),
                abs(torque / (oblique * math.pi * (b * b - a * a)) - 1.0),
            )
        )
    label = f"{name}, both wear, steady"
    texts = "pressure c/r", "approach rate", "torque"
    yield from checks_of(errors, [(f"{label}: {text}", 1e-6, 1e-9) for text in texts])


_CONE = SORTS["cones of 5 degrees"]


def slope_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check matched cones, unworn and worn. Collective on comm."""
    bathed = [bathed_errors(n, comm) for n in SIZES]
    label = "cones of 5 degrees bathed in their pressure"
    rows = ((f"{label}: approach", 1e-6), (f"{label}: uniform pressure, worst element", 1e-6))
    yield from checks_of(bathed, rows)
    for degrees in reference.CONE_APPROACH:
        yield from _cone_rows(degrees, comm)
    for degrees in (5, 10):
        yield from _fine_rows(f"cones of {degrees} degrees", comm)


def cone_errors(
    degrees: float, line: ContactLine, pressure: FloatArray, approach: float
) -> dict[str, float]:
    """Return relative errors against finite elements: ``approach`` and, but for 0 degrees, p(r)."""
    errors = {"approach": abs(approach / reference.CONE_APPROACH[degrees] - 1.0)}
    if degrees in reference.CONE_PRESSURE:
        computed = np.array([pressure_at(line, pressure, r) for r in reference.CONE_RADII])
        errors["p(r)"] = float(np.abs(computed / reference.CONE_PRESSURE[degrees] - 1.0).max())
    return errors


def _cone_rows(degrees: float, comm: MPI.Comm) -> Iterator[Check]:
    errors: list[dict[str, float]] = []
    for n in SIZES:
        case = ring_case(Rings(CONTACT, (1e4, 1e5), degrees), Mesh(n))
        first = first_contact(case, comm)
        errors.append(cone_errors(degrees, case.line, first.pressure, first.approach))
    way = {0.0: "flat", 1.0: "rising"}.get(degrees, "falling")
    label = f"matched cones of {abs(degrees):g} degree, {way}" if degrees else "flat flush rings"
    rows = (
        (f"{label}, finite elements: approach", 1e-4, 5e-6),
        (f"{label}, finite elements: p, worst of 5 radii", 2e-3, 2e-4),
    )
    yield from checks_of([list(error.values()) for error in errors], rows[: len(errors[0])])


def _fine_rows(name: str, comm: MPI.Comm) -> Iterator[Check]:
    """Check cones against their fine solution, their torque, held faces, and what is steady."""
    rings, fine = SORTS[name], stored(name)
    cases = [ring_case(rings, Mesh(n)) for n in SIZES]
    pairs = [assemble(case, comm) for case in cases]
    histories = [trace(case, comm, pair=pair) for case, pair in zip(cases, pairs, strict=True)]
    yield from rows_against(name, [fine.on(Mesh(n)) for n in SIZES], histories)
    first, physics = histories[-1].states[0].contact, histories[-1].physics
    n, line = physics.line.n, physics.line
    flat = physics.case.friction_at(0.0) * (line.area * line.arm) @ first.pressure
    error = abs(
        physics.torque(first.pressure)[0] / flat * math.cos(math.radians(rings.degrees)) - 1.0
    )
    yield identity(f"{name}: torque, 1 / cos alpha of a flat face's", n,
                   float(error), 1e-12)  # fmt: skip
    balances = [(h.balances.reaction, h.balances.torque) for h in histories]
    rows = [(f"{name}: {text} on the held faces, all steps", 1e-4) for text in ("force", "torque")]
    yield from checks_of(balances, rows, kind="identity")
    yield from steady_rows(name, rings, pairs, comm)
    yield from both_wear(name, rings, pairs[1], comm)


def bathed_errors(n: int, comm: MPI.Comm) -> tuple[float, float]:
    """Return the errors of cones of 5 degrees all of whose free faces bear 1 MPa, as the contact.

    The force is that of 1 MPa in the contact; fixed faces leave u_r free. Of the approach, and of
    the worst pressure. The symmetric compliance is made for pressures that are singular at these
    edges, as those of faces of this shape are: of this one, which is not, it alone misses the
    outermost elements by tens of per cent, and all depends on its correction.
    """
    case = ring_case(_CONE, Mesh(n))
    case = replace(case, lower=replace(case.lower, grip="platen"),
                   upper=replace(case.upper, grip="platen"))  # fmt: skip
    pair = assemble(case, comm)
    both, moduli, line = bodies(case), young(case), pair.line
    sides = zip(both, moduli, (pair.slope, -pair.slope), strict=True)
    deflection = sum((_bath(body, case, t, comm) / e for body, e, t in sides), np.zeros(n))
    compliance, approach, p = pair.compliance(moduli), 0.0, np.zeros(n)
    for _ in range(6):  # deferred correction, as a history does
        gap = deflection - compliance.excess @ p
        right = np.stack([line.area, line.area * gap], axis=1)
        unit, bath = np.linalg.solve(compliance.matrix, right).T
        approach = float(line.area @ (1.0 + bath) / (line.area @ unit))
        p = approach * unit - bath
    rise = math.tan(math.radians(_CONE.degrees)) * CONTACT[0]
    apexes = (
        body.section.height + float(body.section.points[0, 1]) - side * rise
        for body, side in zip(both, (1.0, -1.0), strict=True)
    )
    exact = reference.bathed_approach(apexes, moduli, NU, 1.0)
    return abs(approach / exact - 1.0), float(np.abs(p - 1.0).max())


def _bath(body: Body, case: Case, slope: FloatArray, comm: MPI.Comm) -> FloatArray:
    """Return the deflection of a contact face, mm at E = 1, under 1 MPa on the sides of a body."""
    line, mesh = case.line, case.mesh
    boundary = boundary_mesh(body.section, line, mesh)
    loaded = boundary_conditions(boundary, body.grip, slope)
    load, traction = np.full_like(loaded.load, -1), np.zeros_like(loaded.traction)
    for side, value in ((boundary.inner_side, 1.0), (boundary.outer_side, -1.0)):
        load[side, 0], traction[side, 0] = 0, value
    middle = boundary.elements[boundary.contact, 1]
    response = solve_body(
        boundary, loaded._replace(load=load, traction=traction, n_loads=1), body.poisson,
        mesh.quadrature_tolerance, middle, boundary.contact, comm,
    )  # fmt: skip
    radial, axial = response.displacement[:, 0, 0], response.displacement[:, 1, 0]
    return slope * radial - axial
