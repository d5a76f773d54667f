"""Stress inside bodies against closed forms of the half-space and converged finite elements.

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
from ringwear_par.elasticity.bem.body import boundary_responses
from ringwear_par.elasticity.geometry.mesh import Mesh, contact_line
from ringwear_par.elasticity.geometry.sections import Body, Section
from ringwear_par.elasticity.stress.measures import max_shear, mises
from ringwear_par.elasticity.stress.recovery import (
    StressPoints,
    StressRecovery,
    load_stress_kernels,
)
from ringwear_par.elasticity.stress.zone import ZoneStress
from ringwear_par.history.elastic.bodies import bodies
from ringwear_par.history.model import WearModel
from ringwear_par.history.start import initial_state
from ringwear_par.verification import reference
from ringwear_par.verification.check import NU, SIZES, Check
from ringwear_par.verification.paper import paper_case

#: radius and height of the disc, over that of the contact
_BIG = 200.0
_TRUNCATION = 3.0 / _BIG**2
#: where fields are compared: radii and depths, from the axis to under the edge
_FIELD = np.array([(r, d) for d in (0.1, 0.3, 0.48, 1.0, 2.0) for r in (0.0, 0.3, 0.6, 0.9, 1.0)])
#: depths at which the largest shear of Hertz is looked for
_UNDER = np.linspace(0.40, 0.56, 9)


def stress_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare stresses inside with exact and with converged ones. Collective on comm."""
    load_stress_kernels(comm)
    found = [_under_a_disc(n, comm) for n in SIZES]
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
    for i, (name, (tolerance, digits)) in enumerate(allowed.items()):
        yield Check(name, SIZES, tuple(errors[i] for errors in found), tolerance, digits)
    values = [_paper_stresses(n, comm) for n in SIZES]
    for i, ((name, depth), exact) in enumerate(reference.PAPER_STRESS.items()):
        errors = tuple(abs(v[i] / exact - 1.0) for v in values)
        told = f"paper, 50 MPa: {name}, {depth:g} mm under r = 30"
        yield Check(told, SIZES, errors, 1e-4, 5e-6)


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
    with WearModel([case], comm) as model:
        pressure = initial_state(model).contact.pressure[0]
    top = case.lower.z[1]
    keys = list(reference.PAPER_STRESS)
    points = np.array([[30.0, top - depth] for _, depth in keys])
    recovery = StressRecovery(
        bodies(case), case.line, case.mesh, (top, case.upper.z[0]),
        (StressPoints(points, np.zeros(len(points))), StressPoints(np.empty((0, 2)), np.empty(0))),
        0.1, comm,
    )  # fmt: skip
    stress: FloatArray = recovery.stresses(pressure, case.friction)[0].points
    measures = {"von Mises": mises(stress), "largest shear": max_shear(stress)}
    return [float(measures[name][i]) for i, (name, _) in enumerate(keys)]
