"""Bodies alone against exact fields, and stress inside them against closed forms.

Bar, Lame, torsion, and the closure of the kernels; the half-space and converged finite elements.
The half-space is stood in for by a disc so large that what its truncation adds, about the pressure
times (a / R)^2, is below the tolerances.
"""

import math
from collections.abc import Iterator
from functools import partial

import numpy as np
from mpi4py import MPI
from scipy.linalg import solve

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.body import (
    boundary_conditions,
    boundary_responses,
    compliance,
    solve_body,
)
from ringwear_par.elasticity.bem.boundary import boundary_mesh
from ringwear_par.elasticity.bem.kernels import ring_kernels
from ringwear_par.elasticity.bem.systems import BoundaryConditions
from ringwear_par.elasticity.mesh import ContactLine, Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Section
from ringwear_par.elasticity.stress.fields import max_shear, mises
from ringwear_par.elasticity.stress.recovery import (
    StressPoints,
    StressRecovery,
    load_stress_kernels,
)
from ringwear_par.elasticity.stress.zone import ZoneStress
from ringwear_par.history.elastic.bodies import bodies
from ringwear_par.history.start import first_contact
from ringwear_par.verification import reference
from ringwear_par.verification.check import NU, SIZES, Check, checks_of, converging
from ringwear_par.verification.histories import paper_case

#: radius and height of the disc, over the radius of the contact
_BIG = 200.0
_TRUNCATION = 3.0 / _BIG**2
#: where fields are compared: radii and depths, from the axis to under the edge
_FIELD = np.array([(r, d) for d in (0.1, 0.3, 0.48, 1.0, 2.0) for r in (0.0, 0.3, 0.6, 0.9, 1.0)])
#: depths at which the largest shear of Hertz is looked for
_UNDER = np.linspace(0.40, 0.56, 9)


def closure_error() -> float:
    """Return the largest error of Int T ds = 0 or -1 for rigid u_z and u_theta = r.

    The source is outside or inside a closed rectangle, far enough for 200-point Gauss rules.
    """
    corners = [(20.0, 0.0), (40.0, 0.0), (40.0, 20.0), (20.0, 20.0)]
    nodes, weights = np.polynomial.legendre.leggauss(200)
    t, w = 0.5 * (nodes + 1.0), 0.5 * weights
    worst = 0.0
    for r, z, expected in ((30.0, 10.0, -1.0), (50.0, 5.0, 0.0), (5.0, 8.0, 0.0)):
        axial = turning = 0.0
        for (r0, z0), (r1, z1) in zip(corners, corners[1:] + corners[:1], strict=True):
            length = math.hypot(r1 - r0, z1 - z0)
            normal = (z1 - z0) / length, -(r1 - r0) / length
            for ti, wi in zip(t, w, strict=True):
                a, b = r0 + ti * (r1 - r0) - r, z0 + ti * (z1 - z0) - z
                values = ring_kernels(r, a, b, *normal, NU)
                axial += wi * length * values[8]
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


def torsion_error(n: int, comm: MPI.Comm, degrees: float = 0.0) -> float:
    """Return the error of u_theta = twist r (z + h) on top of a hollow cylinder, or on a cone.

    Its traction per true area is shear x twist x r cos alpha; the top rises by alpha outwards.
    """
    alpha, (a, b), height = math.radians(degrees), (20.0, 40.0), 20.0
    face = ((a, -(b - a) * math.tan(alpha)), (b, 0.0)) if degrees else ()
    section, line = Section((a, b), height, face), contact_line((a, b), Mesh(n))
    boundary = boundary_mesh(section, line, Mesh(n))
    conditions = boundary_conditions(boundary, "clamped", np.full(n, math.tan(alpha)))
    middle = boundary.elements[boundary.contact, 1]
    response = solve_body(boundary, conditions, NU, 1e-8, middle, boundary.contact, comm)
    r, z = boundary.nodes[middle].T
    shear = 0.5 / (1.0 + NU)
    u = response.displacement[:, 2] @ (shear * r * math.cos(alpha))
    return float(np.abs(u / (r * (z + height)) - 1.0).max())


def elasticity_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare bodies under simple loads with their exact solutions. Collective on comm."""
    yield Check("traction kernel: rigid modes, sources inside and outside", (1,),
                (closure_error(),), 1e-12, kind="identity")  # fmt: skip
    yield converging("bar with free sides: u_z", partial(bar_error, comm=comm), 1e-6)
    yield converging("Lame, plane strain: u_r of the bore", partial(lame_error, comm=comm), 1e-6)
    yield converging(
        "torsion of a hollow cylinder: u_theta", partial(torsion_error, comm=comm), 1e-3
    )


def cone_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare a ring with a conical top with its exact solution. Collective on comm."""
    yield converging("torsion of a ring with a conical top of 10 degrees: u_theta",
                     partial(torsion_error, comm=comm, degrees=10.0), 1e-3)  # fmt: skip


def stress_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare stresses inside with exact and with converged ones. Collective on comm."""
    load_stress_kernels(comm)
    all_errors = [_under_a_disc(n, comm) for n in SIZES]
    torsion = 1e-6  # which truncation disturbs less
    allowed = {
        "Hertz: stresses inside, over p_max": (2e-4, _TRUNCATION),
        "Hertz: largest shear": (2e-4, _TRUNCATION),
        "Hertz: its depth": (1e-3, _TRUNCATION),
        "Hertz with friction: torsion stresses inside, over mu p_max": (2e-4, torsion),
        "disc turned on a half-space (Reissner-Sagoci): stresses inside, over mean shear": (
            1e-3, torsion,
        ),
    }  # fmt: skip
    yield from checks_of(all_errors, [(name, *limits) for name, limits in allowed.items()])
    exact = list(reference.PAPER_STRESS.values())
    values = [(np.divide(_paper_stresses(n, comm), exact) - 1.0).tolist() for n in SIZES]
    yield from checks_of(
        values,
        [
            (f"paper, 50 MPa: {name}, {depth:g} mm under r = 30", 1e-4, 5e-6)
            for name, depth in reference.PAPER_STRESS
        ],
    )


def _under_a_disc(n: int, comm: MPI.Comm) -> tuple[float, ...]:
    """Return the errors of a disc under the loads that are known. Collective on comm."""
    mesh = Mesh(n, grading=3.0)
    line = contact_line((0.0, 1.0), mesh)
    body = Body(Section((0.0, _BIG), _BIG), 1.0, NU, "clamped")
    (unit,) = boundary_responses(body, line, mesh, comm)
    r, depth = _FIELD.T
    at = ZoneStress(unit).at
    field = at(np.stack([r, -depth], axis=1))
    # what loads are on the elements: means over their areas
    hertz = -np.diff((1.0 - line.edges**2) ** 1.5) / 1.5 / np.diff(line.edges**2)
    pressed = field.stress(hertz, hertz)
    exact = reference.hertz_stress(r, depth, NU)
    torsion = reference.torsion_stress(r, depth, reference.hertz_shear)
    under = max_shear(
        at(np.stack([np.zeros_like(_UNDER), -_UNDER], axis=1)).stress(hertz, np.zeros(n))
    )
    largest, where = reference.hertz_largest_shear(NU)
    fit = np.polynomial.Polynomial.fit(_UNDER, under, 4)
    stationary = fit.deriv().roots()
    real = stationary[np.abs(stationary.imag) < 1e-9].real
    peak = float(real[(real > _UNDER[0]) & (real < _UNDER[-1])][0])
    middle = unit.boundary.elements[unit.boundary.contact, 1]
    turned = solve(unit.displacement[middle, 2], line.arm)
    sagoci = field.stress(np.zeros(n), turned)
    shear = 0.5 / (1.0 + NU)
    mean = reference.reissner_sagoci_torque(shear, 1.0, 1.0) / (2.0 * math.pi / 3.0)
    turning = reference.torsion_stress(r, depth, partial(reference.reissner_sagoci_shear, shear))
    return (
        float(np.abs(pressed[:, :4] - exact).max()),
        abs(float(fit(peak)) / largest - 1.0),
        abs(peak / where - 1.0),
        float(np.abs(pressed[:, 4:] - torsion).max()),
        float(np.abs(sagoci[:, 4:] - turning).max()) / mean,
    )


def _paper_stresses(n: int, comm: MPI.Comm) -> list[float]:
    """Return the stresses of the paper's lower ring, in the order of the reference's."""
    case = paper_case(Mesh(n), pressure=50.0)
    pressure = first_contact(case, comm).pressure
    top = case.lower.z[1]
    keys = list(reference.PAPER_STRESS)
    points = np.array([[30.0, top - depth] for _, depth in keys])
    recovery = StressRecovery(
        bodies(case), case.line, case.mesh, (top, case.upper.z[0]),
        (StressPoints(points, np.zeros(len(points))), StressPoints(np.empty((0, 2)), np.empty(0))),
        0.1, comm,
    )  # fmt: skip
    stress: FloatArray = recovery.stresses(pressure, case.friction_at(0.0))[0].points
    measures = {"von Mises": mises(stress), "largest shear": max_shear(stress)}
    return [float(measures[name][i]) for i, (name, _) in enumerate(keys)]
