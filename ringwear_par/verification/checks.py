"""``ringwear verify``: computed solutions against the exact ones of ``reference``.

Half-spaces are stood in for by solid discs of radius and height R, held at the base. What the
truncation adds to a compliance is proportional to 1/R, so results at R = 50 b and 100 b are
extrapolated to R = infinity; what is left, (b/R)^2 or less, is below the tolerances.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from mpi4py import MPI
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Load, Output, Ring, Stepping
from ringwear_par.contact.problem import ContactState
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.elasticity.assembly import BoundaryConditions, load_kernels
from ringwear_par.elasticity.body import boundary_conditions, compliance, solve_body
from ringwear_par.elasticity.kernels import ring_kernels
from ringwear_par.elasticity.mesh import ContactLine, Mesh, boundary_mesh, contact_line
from ringwear_par.elasticity.pair import symmetric
from ringwear_par.elasticity.sections import Body, Polyline, Section
from ringwear_par.history.model import Balances, State, WearHistory, run
from ringwear_par.history.pairs import contact_compliance
from ringwear_par.options import reject_unused_options
from ringwear_par.verification import reference
from ringwear_par.wear.threshold import ThresholdLaw

SIZES = (32, 64, 128)
NU = 0.3
_GRADED = 3.0


@dataclass(frozen=True)
class Check:
    """One row: relative (or stated) errors at one or more sizes, the last to meet the tolerance.

    Parameters
    ----------
    name : what is compared with what.
    sizes : numbers of contact elements.
    errors : one for each size.
    tolerance : largest error allowed at the last size.
    digits : relative accuracy of the reference itself; errors near it show no order.
    """

    name: str
    sizes: tuple[int, ...]
    errors: tuple[float, ...]
    tolerance: float
    digits: float = 1e-7

    @property
    def passed(self) -> bool:
        """Whether the last error is small enough (not so for NaN)."""
        return self.errors[-1] <= self.tolerance

    @property
    def order(self) -> float | None:
        """Observed order over the last two sizes whose errors exceed the reference's own."""
        clear = [
            (n, e) for n, e in zip(self.sizes, self.errors, strict=True) if e > 3 * self.digits
        ]
        if len(clear) < 2:
            return None
        (n1, e1), (n2, e2) = clear[-2:]
        return math.log(e1 / e2) / math.log(n2 / n1)


def _converging(
    name: str, error: Callable[[int], float], tolerance: float, sizes: tuple[int, ...] = SIZES
) -> Check:
    return Check(name, sizes, tuple(error(n) for n in sizes), tolerance)


# -- elasticity ------------------------------------------------------------------------------------


def closure_error() -> float:
    """Return the largest error of Int T ds = 0 or -1 for rigid u_z and u_theta = r.

    The source is outside or inside a closed rectangle, far enough for 200-point Gauss rules.
    """
    corners = [(20.0, 0.0), (40.0, 0.0), (40.0, 20.0), (20.0, 20.0)]
    x, w = np.polynomial.legendre.leggauss(200)
    t, w = 0.5 * (x + 1.0), 0.5 * w
    worst = 0.0
    for r, z, expected in ((30.0, 10.0, -1.0), (50.0, 5.0, 0.0), (5.0, 8.0, 0.0)):
        axial = turning = 0.0
        for (r0, z0), (r1, z1) in zip(corners, corners[1:] + corners[:1], strict=True):
            length = math.hypot(r1 - r0, z1 - z0)
            normal = (z1 - z0) / length, -(r1 - r0) / length
            for ti, wi in zip(t, w, strict=True):
                a, b = r0 + ti * (r1 - r0) - r, z0 + ti * (z1 - z0) - z
                values = ring_kernels(r, a, b, *normal, NU)
                axial += wi * length * values[7]
                turning += wi * length * values[9] * (r + a)
        worst = max(worst, abs(axial - expected), abs(turning / r - expected))
    return worst


def _hollow(n: int) -> tuple[Section, ContactLine]:
    """Return a hollow cylinder with its whole top as contact line."""
    return Section((20.0, 40.0), 20.0), contact_line((20.0, 40.0), Mesh(n))


def bar_error(n: int, comm: MPI.Comm) -> float:
    """Return the error of u_z on top of a bar with free sides under uniform pressure."""
    section, line = _hollow(n)
    body = compliance(Body(section, 1.0, NU, "platen"), line, Mesh(n), comm)
    return float(np.abs(body.normal.sum(axis=1) / section.height - 1.0).max())


def lame_error(n: int, comm: MPI.Comm) -> float:
    """Return the error of u_r on the bore of a ring between two smooth planes, both pressures."""
    (section, line), inner, outer = _hollow(n), 3.0, 1.0
    boundary = boundary_mesh(section, line, Mesh(n))
    k = len(boundary.elements)
    fixed = np.zeros((k, 3), dtype=bool)
    fixed[np.concatenate([boundary.fixed, boundary.contact]), 1] = True
    fixed[boundary.fixed, 2] = True
    load, traction = np.full((k, 3), -1), np.zeros((k, 3))
    for side, value in ((boundary.inner_side, inner), (boundary.outer_side, -outer)):
        load[side, 0], traction[side, 0] = 0, value
    conditions = BoundaryConditions(fixed, load, traction, 1)
    bore = boundary.elements[boundary.inner_side, 1]
    response = solve_body(boundary, conditions, NU, 1e-8, bore, boundary.inner_side, comm)
    exact = reference.lame_displacement(np.array(20.0), 20.0, 40.0, inner, outer, 1.0, NU)
    return float(np.abs(response.displacement[:, 0, 0] / exact - 1.0).max())


def torsion_error(n: int, comm: MPI.Comm) -> float:
    """Return the error of u_theta on top of a hollow cylinder, traction proportional to r."""
    section, line = _hollow(n)
    boundary = boundary_mesh(section, line, Mesh(n))
    conditions = boundary_conditions(boundary, "clamped")
    middle = boundary.elements[boundary.contact, 1]
    response = solve_body(boundary, conditions, NU, 1e-8, middle, boundary.contact, comm)
    r = boundary.nodes[middle, 0]
    torque, shear = 1.0, 0.5 / (1.0 + NU)
    twist = torque / (shear * reference.polar_moment(20.0, 40.0))
    u = response.displacement[:, 2] @ (shear * twist * r)
    return float(np.abs(u / (twist * r * section.height) - 1.0).max())


# -- contact on a half-space -----------------------------------------------------------------------


@dataclass(frozen=True)
class _Indentation:
    """A rigid annulus on a disc of radius R, at E = 1: compliance, pressure, decays, torsion."""

    force: float  # per unit approach
    middle: float  # p at the middle radius / mean p
    first: float  # largest relative error of p of the four innermost elements of a cylinder
    torque: float  # per unit angle
    decay_force: FloatArray
    decay_approach: FloatArray


def _indentation(a: float, big_r: float, n: int, comm: MPI.Comm) -> _Indentation:
    contact, mesh = (a, 1.0), Mesh(n, grading=_GRADED)
    line = contact_line(contact, mesh)
    disc = Body(Section((0.0, big_r), big_r), 1.0, NU, "clamped")
    unit = compliance(disc, line, mesh, comm)
    m = line.area
    normal = symmetric(line, unit.normal)
    p = np.linalg.solve(normal, m)
    shear = np.linalg.solve(_symmetric(m, unit.torsion), m * line.arm)
    worn = np.diag(m * line.arm)
    free = np.linalg.svd(m[None, :])[2][1:].T  # pressures that change, at constant force
    modulus = reference.contact_modulus((1.0, NU))
    return _Indentation(
        float(m @ p),
        pressure_at(line, p, 0.5 * (a + 1.0)) * float(m.sum() / (m @ p)),
        _first_error(line, p) if a == 0.0 else math.nan,
        float((m * line.arm) @ shear),
        eigh(free.T @ worn @ free, free.T @ normal @ free, eigvals_only=True)[:2] / modulus,
        eigh(worn, normal, eigvals_only=True)[:2] / modulus,
    )


def _first_error(line: ContactLine, p: FloatArray) -> float:
    exact = reference.flat_cylinder_pressure(1.0, line.edges[:5])
    mean = float(line.area @ p / line.area.sum())
    return float(np.abs(p[:4] / mean / exact - 1.0).max())


def _symmetric(m: FloatArray, matrix: FloatArray) -> FloatArray:
    weighted = m[:, None] * matrix
    return 0.5 * (weighted + weighted.T)


def pressure_at(line: ContactLine, p: FloatArray, r: float) -> float:
    """Return the pressure at a radius from element values, all positive. Not collective.

    Cubic interpolation of log p against log(s1/s2), s1 and s2 being the distances to the edges, in
    which powers of the distance to an edge are straight lines.
    """
    inner, outer = line.edges[0], line.edges[-1]
    if inner == 0.0:  # no edge on the axis
        position, x = line.r, r
    else:
        position = np.log((line.r - inner) / (outer - line.r))
        x = math.log((r - inner) / (outer - r))
    return float(np.exp(CubicSpline(position, np.log(p))(x)))


#: of a rigid flat cylinder: F / (2 E* a delta), and p(a/2) / p(mean) = 1 / (2 sqrt(1 - 1/4))
_CYLINDER = 1.0, 1.0 / math.sqrt(3.0)


def _without_truncation(at_50_and_100: Iterable[float]) -> float:
    """Return a stiffness for R = infinity, its inverse being linear in 1/R."""
    one, two = at_50_and_100
    return 1.0 / (2.0 / two - 1.0 / one)


def half_space_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare rigid annuli and the turned disc with their half-space solutions."""
    modulus, shear = reference.contact_modulus((1.0, NU)), 0.5 / (1.0 + NU)
    for ratio, (force, middle) in {0.0: _CYLINDER, **reference.ANNULUS}.items():
        runs = {n: [_indentation(ratio, big_r, n, comm) for big_r in (50.0, 100.0)] for n in SIZES}
        name = f"rigid flat annulus a/b = {ratio:g}" if ratio else "rigid flat cylinder"

        def row(text: str, values: list[float], exact: float, tolerance: float,
                digits: float = 1e-7, name: str = name) -> Check:  # fmt: skip
            errors = tuple(abs(value / exact - 1.0) for value in values)
            return Check(f"{name}: {text}", SIZES, errors, tolerance, digits)

        unit = reference.flat_cylinder_force(modulus, 1.0, 1.0)
        forces = [_without_truncation(r.force for r in runs[n]) for n in SIZES]
        yield row("force", forces, force * unit, 1e-4, 1e-6)
        yield row("p(mid)/p(mean)", [runs[n][1].middle for n in SIZES], middle, 1e-3, 1e-5)
        if not ratio:
            yield Check(f"{name}: p at the axis, worst of 4 elements", SIZES,
                        tuple(runs[n][1].first for n in SIZES), 1e-3)  # fmt: skip
            torque = reference.reissner_sagoci_torque(shear, 1.0, 1.0)
            turned = "disc turned on a half-space (Reissner-Sagoci)"
            yield row("torque", [runs[n][1].torque for n in SIZES], torque, 1e-4, name=turned)
        if ratio == 0.5:
            for i in (0, 1):
                rates = [runs[n][1].decay_force[i] for n in SIZES]
                exact = reference.DECAY_FORCE[i]
                yield row(f"decay {i + 1}, given force", rates, exact, 5e-4, 2e-4)
                rates = [_without_truncation(r.decay_approach[i] for r in runs[n]) for n in SIZES]
                exact = reference.DECAY_APPROACH[i]
                yield row(f"decay {i + 1}, given approach", rates, exact, 1e-3, 2e-4)


#: radius of the sphere and slope of the cone, their approaches make the contact radius 1
_SPHERE, _CONE = 10.0, 0.1
#: radius of these bodies. Errors depend on where in an element the contact ends
_REACH = 1.6


def _indented(profile: FloatArray, approach: float, big_r: float, n: int,
              comm: MPI.Comm) -> tuple[ContactLine, ContactState]:  # fmt: skip
    """Press a rigid body of revolution, given as r and depth, into a disc of radius R at E = 1."""
    reach = float(profile[-1, 0])
    face = tuple((float(r), -float(z)) for r, z in profile)
    case = Case(
        Ring((0.0, big_r), (0.0, big_r), 1.0, NU, "clamped"),
        Ring((0.0, reach), (big_r, big_r + 2.0), 1e13, NU, "clamped", face),
        0.1, None, None, Load(0.0, displacement=approach), _PAPER_STEPPING,
        Mesh(n, grading=1.0), Output(),
    )  # fmt: skip
    pair = contact_compliance(case, comm)
    with ContactSolver(pair.matrix, pair.line.area, comm) as solver:
        return pair.line, WearHistory(case, pair, solver).start().contact


def _indented_force(forces: Iterable[float], approach: float, power: float) -> float:
    """Return the force for R = infinity of approach = alpha F^power + beta F/R."""
    compliance = [approach / force**power for force in forces]
    shift = [
        force ** (1.0 - power) / big_r for force, big_r in zip(forces, (50.0, 100.0), strict=True)
    ]
    beta = (compliance[0] - compliance[1]) / (shift[0] - shift[1])
    return float((approach / (compliance[1] - beta * shift[1])) ** (1.0 / power))


def sphere_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare a rigid sphere and a rigid cone on a half-space with Hertz and Sneddon."""
    modulus, approach = reference.contact_modulus((1.0, NU)), 1.0 / _SPHERE
    force, a, p_max = reference.hertz(modulus, _SPHERE, approach)
    r = np.linspace(0.0, _REACH, 401)
    sphere = np.stack([r, r * r / (2.0 * _SPHERE)], axis=1)
    found: list[list[float]] = []
    for n in SIZES:
        forces, radii, peaks = [], [], []
        for big_r in (50.0, 100.0):
            line, state = _indented(sphere, approach, big_r, n, comm)
            forces.append(state.force)
            x, y = line.r**2, state.pressure**2  # p^2 is linear in r^2
            outer, inner = (x > 0.5) & (x < 0.9), x < 0.25
            slope, at_axis = np.polyfit(x[outer], y[outer], 1)
            radii.append(math.sqrt(-at_axis / slope))
            peaks.append(math.sqrt(np.polyfit(x[inner], y[inner], 1)[1]))
        found.append(
            [_indented_force(forces, approach, 2.0 / 3.0) / force - 1.0]
            + [(2.0 * v[1] - v[0]) / exact - 1.0 for v, exact in ((radii, a), (peaks, p_max))]
        )
    for i, (text, tolerance) in enumerate(
        (("force", 1e-4), ("contact radius", 1e-3), ("largest pressure", 1e-3))
    ):
        # of the order of (a/R)^2, what the extrapolation leaves
        errors = tuple(abs(v[i]) for v in found)
        yield Check(f"sphere (Hertz): {text}", SIZES, errors, tolerance, 3e-5)
    approach = 0.5 * math.pi * _CONE
    cone = np.array([[0.0, 0.0], [_REACH, _REACH * _CONE]])
    found.clear()
    for n in SIZES:
        forces = [_indented(cone, approach, big_r, n, comm)[1].force for big_r in (50.0, 100.0)]
        exact = reference.cone_force(modulus, _CONE, approach)
        found.append([abs(_indented_force(forces, approach, 0.5) / exact - 1.0)])
    yield Check("rigid cone: force", SIZES, tuple(v[0] for v in found), 1e-4, 3e-5)


# -- the paper's rings -----------------------------------------------------------------------------


#: our reading of the paper's speed, rad/s
OMEGA = 85.0 / 24.0
_PAPER_STEPPING = Stepping("implicit", 1.0, 200)


def paper_case(
    mesh: Mesh, pressure: float = 80.0, p0: tuple[float | None, float | None] = (40.0, None),
    stepping: Stepping = _PAPER_STEPPING, young: float = 100e3,
    k: tuple[float, float] = (1e-7, 1e-7),
) -> Case:  # fmt: skip
    """Return the paper's rings (load and speed are our reading), p0 of lower and upper in MPa."""
    laws = [ThresholdLaw(ki, pi) if pi is not None else None for ki, pi in zip(k, p0, strict=True)]
    case = Case(
        Ring((20.0, 40.0), (0.0, 20.0), 10e3, NU, "clamped"),
        Ring((28.5, 31.5), (20.0, 40.0), young, NU, "clamped"),
        0.1, laws[0], laws[1], Load(OMEGA, 1.0), stepping, mesh, Output(),
    )  # fmt: skip
    return replace(case, load=Load(OMEGA, pressure * case.area))


def paper_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare the unworn paper case with an independent finite element solution."""
    sizes, pressures = (32, 64, 128, 256), reference.PAPER_PRESSURE
    values: list[list[float]] = []
    for n in sizes:
        case = paper_case(Mesh(n), pressure=50.0)
        pair = contact_compliance(case, comm)
        with ContactSolver(pair.matrix, pair.line.area, comm) as solver:
            history = WearHistory(case, pair, solver)
            contact = history.start().contact
        p = contact.pressure
        values.append(
            [contact.approach / reference.PAPER_APPROACH - 1.0,
             history.torque(p) / reference.PAPER_TORQUE - 1.0]
            + [pressure_at(pair.line, p, r) / v - 1.0 for r, v in pressures.items()]
        )  # fmt: skip
    names = ["approach", "torque", *(f"p({r:g})" for r in pressures)]
    allowed = ((1e-5, 1.4e-6), (1e-4, 6e-7), (1e-3, 1.5e-5), (1e-3, 6e-6), (1e-3, 6e-6))
    for i, (name, (tolerance, digits)) in enumerate(zip(names, allowed, strict=True)):
        errors = tuple(abs(v[i]) for v in values)
        yield Check(f"paper, 50 MPa: {name}", sizes, errors, tolerance, digits)


def edge_error(ratio: float, comm: MPI.Comm) -> float:
    """Return the error (absolute) of the edge exponent for E2/E1, from 0.003 to 0.03 mm."""
    young = 10e3 * min(ratio, 1e9)
    pair = contact_compliance(paper_case(Mesh(128, grading=4.0), young=young), comm)
    p = np.linalg.solve(pair.matrix, pair.line.area)
    s = (pair.line.r - pair.line.edges[0]) / 3.0
    near = (s > 1e-3) & (s < 1e-2)
    slope = np.polyfit(np.log(s[near]), np.log(p[near]), 1)[0]
    return abs(float(slope) - reference.EDGE_EXPONENT[ratio])


def explicit_limit_error(n: int, comm: MPI.Comm) -> float:
    """Return the error of the largest stable explicit step on a uniform mesh, rigid upper ring.

    The rings are wide (r = 300 mm), so that the sliding speed hardly varies along the contact.
    """
    case = paper_case(Mesh(n, grading=1.0), p0=(0.0, None), young=1e13)
    case = replace(
        case,
        lower=replace(case.lower, r=(290.0, 310.0)),
        upper=replace(case.upper, r=(298.5, 301.5)),
    )
    pair = contact_compliance(case, comm)
    with ContactSolver(pair.matrix, pair.line.area, comm) as solver:
        step = WearHistory(case, pair, solver).stable_step()
    fastest = 1e-7 * case.friction * OMEGA * float(pair.line.arm.max())  # mm/s per MPa
    wear = step * fastest
    modulus = reference.contact_modulus((case.lower.young, NU))
    return abs(wear * modulus / (3.0 / n) / reference.EXPLICIT_LIMIT - 1.0)


def wear_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare long histories of the paper's rings with the steady laws and balances."""
    n, long = 64, Stepping("implicit", 40.0, 200)

    def history(case: Case) -> tuple[WearHistory, State, State]:
        pair = contact_compliance(case, comm)
        with ContactSolver(pair.matrix, pair.line.area, comm) as solver:
            wear = WearHistory(case, pair, solver)
            before = run(
                WearHistory(replace(case, time=replace(case.time, steps=case.time.steps - 1)),
                            pair, solver),
                wear.start(), lambda _: False,
            )  # fmt: skip
            return wear, before, wear.advance(before)

    for p0 in (0.0, 40.0):
        wear, before, after = history(paper_case(Mesh(n), p0=(p0, None), stepping=long))
        case, line = wear.case, wear.pair.line
        assert isinstance(case.load.force, float)
        c = reference.steady_constant(case.load.force, p0, *case.contact)
        p = after.contact.pressure
        exact = p0 + c / line.arm
        yield Check(f"steady pressure p0 + c/r, p0 = {p0:g} MPa", (n,),
                    (float(np.abs(p / exact - 1.0).max()),), 1e-3)  # fmt: skip
        rate = (after.contact.approach - before.contact.approach) / case.time.step
        kappa = case.friction * 1e-7
        yield Check(f"steady approach rate kappa omega c, p0 = {p0:g} MPa", (n,),
                    (abs(rate / (kappa * OMEGA * c) - 1.0),), 1e-3)  # fmt: skip
        if p0 == 0.0:
            yield Check("worn volume = k x dissipated energy, worst of all steps", (n,),
                        (after.balances.energy,), 1e-10)  # fmt: skip
        yield Check(f"force balance, worst of all steps, p0 = {p0:g} MPa", (n,),
                    (after.balances.force,), 1e-10)  # fmt: skip
        yield Check(f"volume balance, worst of all steps, p0 = {p0:g} MPa", (n,),
                    (after.balances.volume,), 1e-12)  # fmt: skip

    both = paper_case(Mesh(n), p0=(0.0, 0.0), stepping=long, k=(1e-7, 3e-7))
    wear, before, after = history(both)
    assert isinstance(both.load.force, float)
    c = reference.steady_constant(both.load.force, 0.0, *both.contact)
    rate = (after.contact.approach - before.contact.approach) / both.time.step
    exact_rate = both.friction * 4e-7 * OMEGA * c
    yield Check("both wear: approach rate mu (k1 + k2) omega c", (n,),
                (abs(rate / exact_rate - 1.0),), 1e-3)  # fmt: skip
    split = float(np.abs(after.wear[1] / after.wear[0] / 3.0 - 1.0).max())
    yield Check("both wear: depths split k1 : k2", (n,), (split,), 1e-10)

    fixed = paper_case(Mesh(n), p0=(0.0, None), stepping=long)
    fixed = replace(fixed, load=Load(fixed.load.omega, displacement=0.0585))
    wear, _, after = history(fixed)
    mean = 80.0  # MPa, at the start
    yield Check("fixed approach: pressure falls to 0, relative to its first mean", (n,),
                (float(after.contact.pressure.max()) / mean,), 1e-3)  # fmt: skip


def adaptive_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare adaptive histories with steady laws, similarity, balances and their own limit."""
    n = 64
    pair = contact_compliance(paper_case(Mesh(n)), comm)
    line = pair.line
    with ContactSolver(pair.matrix, line.area, comm) as solver:

        def last(case: Case, end: float, tolerance: float = 2.5e-6) -> State:
            solver.cold_start()
            stepping = Stepping("adaptive", until=end, tolerance=tolerance)
            history = WearHistory(replace(case, time=stepping), pair, solver)
            return run(history, history.start(), lambda _: False)

        for p0 in (0.0, 40.0):
            case = paper_case(Mesh(n), p0=(p0, None))
            for end, most in ((200.0, 20), (2000.0, 30)):
                state = last(case, end)
                error = np.abs(state.wear - last(case, end, 1e-9).wear).max()
                yield Check(f"adaptive, p0 = {p0:g} MPa, {end:g} s: wear, mm", (n,),
                            (float(error),), 1e-5)  # fmt: skip
                yield Check(f"adaptive, p0 = {p0:g} MPa, {end:g} s: number of steps", (n,),
                            (float(state.step),), float(most))  # fmt: skip

        thresholds, k = (40.0, 60.0), (1e-7, 3e-7)
        both = paper_case(Mesh(n), p0=thresholds, k=k)
        state = last(both, 8000.0)
        assert isinstance(both.load.force, float)
        mean = (k[0] * thresholds[0] + k[1] * thresholds[1]) / sum(k)
        c = reference.steady_constant(both.load.force, mean, *both.contact)
        error = np.abs(state.contact.pressure / (mean + c / line.arm) - 1.0).max()
        yield Check("both wear, thresholds 40 and 60 MPa: steady pressure", (n,),
                    (float(error),), 1e-3)  # fmt: skip

        one = last(paper_case(Mesh(n), p0=(0.0, 0.0), k=(1e-7, 3e-7)), 300.0)
        two = last(paper_case(Mesh(n), p0=(0.0, 0.0), k=(2e-7, 6e-7)), 150.0)
        yield Check("similarity: wear of twice k in half the time", (n,),
                    (float(np.abs(two.wear / one.wear - 1.0).max()),), 1e-8)  # fmt: skip
        yield Check("both wear: worn volumes = k1, k2 x dissipated energy", (n,),
                    (one.balances.energy,), 1e-10)  # fmt: skip
    yield from growing_checks(comm)


def round_face(r: tuple[float, float], radius: float) -> Polyline:
    """Return the face of a sphere (inner radius 0) or of a torus between two radii, 200 points."""
    samples = np.linspace(*r, 200)
    middle = 0.0 if r[0] == 0.0 else 0.5 * sum(r)
    fall = np.sqrt(radius**2 - (samples - middle) ** 2) - radius
    return tuple(zip(samples.tolist(), fall.tolist(), strict=True))


def growing_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check the balances of a sphere and a torus that wear while their contact grows."""
    for name, r in (("sphere", (0.0, 3.0)), ("torus", (18.0, 22.0))):
        case = replace(
            paper_case(Mesh(48, grading=1.0)),
            lower=Ring((0.0, 30.0), (0.0, 20.0), 2e5, NU, "clamped"),
            upper=Ring(r, (20.0, 30.0), 2e5, NU, "clamped", round_face(r, 40.0)),
            wear_lower=None, wear_upper=ThresholdLaw(1e-6), load=Load(1.0, 300.0),
            time=Stepping("adaptive", until=400.0),
        )  # fmt: skip
        pair = contact_compliance(case, comm)
        with ContactSolver(pair.matrix, pair.line.area, comm) as solver:
            history = WearHistory(case, pair, solver)
            before = history.start()
            after = run(history, before, lambda _: False)
        grown = [np.count_nonzero(state.contact.pressure) for state in (before, after)]
        said = f"worn {name}, contact of {grown[0]} to {grown[1]} elements"
        worst = after.balances if grown[1] > grown[0] else Balances(volume=math.inf)
        yield Check(f"{said}: volume balance", (48,), (worst.volume,), 1e-10)
        yield Check(f"{said}: worn volume = k x energy", (48,), (worst.energy,), 1e-10)


def checks(comm: MPI.Comm) -> Iterator[Check]:
    """Run all reference solutions, one after another. Collective on comm."""
    yield Check("traction kernel: rigid modes, sources inside and outside", (1,),
                (closure_error(),), 1e-12)  # fmt: skip
    yield _converging("bar with free sides: u_z", partial(bar_error, comm=comm), 1e-6)
    yield _converging("Lame, plane strain: u_r of the bore", partial(lame_error, comm=comm), 1e-6)
    yield _converging(
        "torsion of a hollow cylinder: u_theta", partial(torsion_error, comm=comm), 1e-3
    )
    yield from half_space_checks(comm)
    yield from sphere_checks(comm)
    yield from paper_checks(comm)
    for ratio in reference.EDGE_EXPONENT:
        yield Check(f"edge exponent, E2/E1 = {ratio:g} (absolute error)", (128,),
                    (edge_error(ratio, comm),), 4e-3)  # fmt: skip
    yield from wear_checks(comm)
    yield from adaptive_checks(comm)
    yield Check("explicit limit 1.485 h p/E*, uniform mesh", (128,),
                (explicit_limit_error(128, comm),), 2e-2)  # fmt: skip


def verify(comm: MPI.Comm) -> int:
    """Print every check as it is done; return 0 if all passed, else 1. Collective on comm."""
    load_kernels(comm)
    started = time.perf_counter()
    failed = total = 0
    width = 66
    if comm.rank == 0:
        print(
            f"{'':4} {'compared':{width}} {'elements':>8} {'error':>9} {'allowed':>8} {'order':>6}"
        )
    for check in checks(comm):
        total += 1
        failed += not check.passed
        if comm.rank == 0:
            order = f"{check.order:6.2f}" if check.order is not None else f"{'-':>6}"
            print(
                f"{'ok' if check.passed else 'FAIL':4} {check.name:{width}} {check.sizes[-1]:8d} "
                f"{check.errors[-1]:9.1e} {check.tolerance:8.0e} {order}",
                flush=True,
            )
    reject_unused_options()
    if comm.rank == 0:
        print(f"{total - failed} of {total} passed in {time.perf_counter() - started:.0f} s")
    return 1 if failed else 0
