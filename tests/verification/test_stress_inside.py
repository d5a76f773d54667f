"""Stresses inside a half-space under Hertz' pressure, its friction, and a turned disc.

A disc stands in for it, so large that what its truncation adds, about the pressure times (1/R)^2,
is below the tolerances.
"""

import math
from functools import partial

import exact_solutions as exact
import numpy as np
from convergence import check_errors
from reference_cases import NU
from scipy.linalg import solve

from ringwear_par.elasticity.bem.body import body_zones, solve_zones
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Section
from ringwear_par.elasticity.stress.fields import max_shear
from ringwear_par.elasticity.stress.zone import ZoneStress

#: radius and height of the disc, over the radius of the contact
BIG = 200.0
TRUNCATION = 3.0 / BIG**2
#: where fields are compared: radii and depths, from the axis to under the edge
FIELD = np.array([(r, d) for d in (0.1, 0.3, 0.48, 1.0, 2.0) for r in (0.0, 0.3, 0.6, 0.9, 1.0)])
#: depths at which the largest shear of Hertz is looked for
UNDER = np.linspace(0.40, 0.56, 9)


def test_hertz_with_friction_and_a_turned_disc(comm):
    r, depth = FIELD.T
    shear = 0.5 / (1.0 + NU)
    hertz = exact.hertz_stress(r, depth, NU)
    friction = exact.torsion_stress(r, depth, exact.hertz_shear)
    largest, where = exact.hertz_largest_shear(NU)
    mean = exact.reissner_sagoci_torque(shear) / (2.0 * math.pi / 3.0)
    turning = exact.torsion_stress(r, depth, partial(exact.reissner_sagoci_shear, shear))

    def errors(n):
        mesh = Mesh(n, grading=3.0)
        line = contact_line((0.0, 1.0), mesh)
        body = Body(Section((0.0, BIG), BIG), 1.0, NU, "clamped")
        (unit,), _ = solve_zones(body_zones(body, line, mesh), 1e-7, comm)
        at = ZoneStress(unit).at
        field = at(np.stack([r, -depth], axis=1))
        # what loads are on the elements: means over their areas
        load = -np.diff((1.0 - line.edges**2) ** 1.5) / 1.5 / np.diff(line.edges**2)
        pressed = field @ load
        axis = at(np.stack([np.zeros_like(UNDER), -UNDER], axis=1))
        without_friction = axis @ load * [1.0, 1.0, 1.0, 1.0, 0.0, 0.0]
        fit = np.polynomial.Polynomial.fit(UNDER, max_shear(without_friction), 4)
        stationary = fit.deriv().roots()
        (peak,) = (x.real for x in stationary if not x.imag and UNDER[0] < x.real < UNDER[-1])
        middle = unit.boundary.elements[unit.boundary.contact, 1]
        turned = solve(unit.displacement[middle, 2], line.arm)
        sagoci = field @ turned
        return {
            "Hertz, over p_max": np.abs(pressed[:, :4] - hertz).max(),
            "largest shear": fit(peak) / largest - 1.0,
            "its depth": peak / where - 1.0,
            "friction, over mu p_max": np.abs(pressed[:, 4:] - friction).max(),
            "turned disc, over mean shear": np.abs(sagoci[:, 4:] - turning).max() / mean,
        }

    check_errors(errors, {
        "Hertz, over p_max": (2e-4, None), "largest shear": (2e-4, 1.8, TRUNCATION),
        "its depth": (1e-3, None), "friction, over mu p_max": (2e-4, 1.8, 1e-6),
        "turned disc, over mean shear": (1e-3, 1.8, 1e-6),
    })  # fmt: skip
