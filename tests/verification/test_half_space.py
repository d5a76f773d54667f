"""Rigid annuli, spheres and cones on a half-space against their exact solutions.

Half-spaces are stood in for by solid discs of radius and height R, held at the base. What the
truncation adds to a compliance is proportional to 1/R, so results at R = 50 and 100 are
extrapolated to R = infinity; what is left, 1/R^2 or less, is below the tolerances.
"""

import math

import exact_solutions as exact
import numpy as np
import pytest
from convergence import check_errors
from fine_solutions import pressure_at
from parts import Load, Output, Ring, Stepping
from reference_cases import NU
from scipy.linalg import eigvals, solve
from tracing import first_contact

import ringwear_par as rw
from ringwear_par.elasticity.bem.body import compliance
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Section

#: radii of the discs, and E* of E = 1
DISCS, MODULUS = (50.0, 100.0), exact.contact_modulus((1.0, NU))
#: error of the extrapolation of contact radii of 1
EXTRAPOLATION = 3e-5


def extrapolated(first, second):
    """Return a stiffness for R = infinity: its inverse is linear in 1/R."""
    return 1.0 / (2.0 / second - 1.0 / first)


def annulus(a, n, comm):
    """Return force, p(mid)/p(mean), torque and rates of decay of an annulus of outer radius 1."""
    found = []
    for big_r in DISCS:
        mesh = Mesh(n, grading=3.0)
        line = contact_line((a, 1.0), mesh)
        unit = compliance(Body(Section((0.0, big_r), big_r), 1.0, NU, "clamped"), line, mesh, comm)
        m, normal = line.area, unit.normal
        p = solve(normal, np.ones(n))
        # rates of decay of C p' = -r p + rate of the approach, 0 or such that the force stays
        worn, flat = np.diag(line.arm), np.outer(p, m @ np.linalg.inv(normal)) / (m @ p)
        response = np.linalg.inv(normal)
        at_approach = np.sort(eigvals(response @ worn).real)
        at_force = np.sort(eigvals((response - flat) @ worn).real)[1:]  # beside c / r, which stays
        found.append([m @ p, *at_approach[:2] / MODULUS])
    force, *at_approach = map(extrapolated, *found)
    mean = m @ p / m.sum()
    return {
        "force": force,
        "p(mid)/p(mean)": pressure_at(line, p, 0.5 * (a + 1.0)) / mean,
        "p(axis)/p(mean)": p[:4] / mean,
        "torque": (m * line.arm) @ solve(unit.torsion, line.arm),
        "decay, given force": at_force[:2] / MODULUS,
        "decay, given approach": np.array(at_approach),
    }, line


CYLINDER = {
    "force": 1.0, "p(mid)/p(mean)": 1.0 / math.sqrt(3.0), "p(axis)/p(mean)": None,
    "torque": exact.reissner_sagoci_torque(0.5 / (1.0 + NU)),
}  # fmt: skip
ANNULI = {
    0.0: CYLINDER,
    **{a: {"force": f, "p(mid)/p(mean)": p} for a, (f, p) in exact.ANNULUS.items()},
}
ANNULI[0.5] |= {
    "decay, given force": exact.DECAY_FORCE, "decay, given approach": exact.DECAY_APPROACH,
}  # fmt: skip


@pytest.mark.parametrize("a", ANNULI)
def test_rigid_annulus(a, comm):
    """Flat, frictionless, its contact worn, and turned without slip."""
    limits = {
        "force": (1e-4, 1.8 if a in (0.0, 0.5) else None, 1e-6),
        "p(mid)/p(mean)": (1e-3, 1.7 if a == 0.5 else None, 1e-5),
        "p(axis)/p(mean)": (1e-3, 1.8), "torque": (1e-4, None),
        "decay, given force": (5e-4, None), "decay, given approach": (1e-3, None),
    }  # fmt: skip

    def errors(n):
        found, line = annulus(a, n, comm)
        known = dict(ANNULI[a])
        known["force"] *= 2.0 * MODULUS
        if a == 0.0:
            known["p(axis)/p(mean)"] = exact.flat_cylinder_pressure(line.edges[:5])
        return {name: np.abs(found[name] / value - 1.0).max() for name, value in known.items()}

    check_errors(errors, {name: limits[name] for name in ANNULI[a]})


def indented(profile, approach, n, comm):
    """Return the contact line, and the contacts with a body of revolution, of both discs."""
    reach = float(profile[-1, 0])
    face = tuple((float(r), -float(z)) for r, z in profile)
    cases = [
        rw.Case(
            Ring((0.0, big_r), (0.0, big_r), 1.0, NU, "clamped"),
            Ring((0.0, reach), (big_r, big_r + 2.0), 1e13, NU, "clamped", face),
            0.1, None, None, Load(0.0, displacement=approach), Stepping("implicit", 1.0, 1),
            Mesh(n, grading=1.0), Output(),
        )
        for big_r in DISCS
    ]  # fmt: skip
    return cases[0].line, [first_contact(case, comm) for case in cases]


def force_error(contacts, approach, power, known):
    """Return the error of the force for R = infinity of approach = alpha F^power + beta F/R."""
    forces = [contact.force for contact in contacts]
    near, far = (approach / force**power for force in forces)
    first, second = (f ** (1.0 - power) / big_r for f, big_r in zip(forces, DISCS, strict=True))
    alpha = far - (near - far) / (first - second) * second
    return (approach / alpha) ** (1.0 / power) / known - 1.0


def test_sphere(comm):
    """Hertz; the innermost elements too, not only a fit through many."""
    radius, approach = 10.0, 0.1
    force, a, p_max = exact.hertz(MODULUS, radius, approach)
    r = np.linspace(0.0, 1.6, 401)
    profile = np.stack([r, r * r / (2.0 * radius)], axis=1)

    def errors(n):
        line, contacts = indented(profile, approach, n, comm)
        x, numbers = line.r**2, []
        for contact in contacts:
            y, outer, inner = contact.pressure**2, (x > 0.5) & (x < 0.9), x < 0.25
            slope, at_axis = np.polyfit(x[outer], y[outer], 1)  # p^2 is linear in r^2
            peak = math.sqrt(np.polyfit(x[inner], y[inner], 1)[1])
            numbers.append(np.array([math.sqrt(-at_axis / slope), peak, *contact.pressure[:4]]))
        contact_radius, peak, *axis = 2.0 * numbers[1] - numbers[0]
        ends = line.edges[:5] ** 2
        means = p_max * np.diff(-((1.0 - ends) ** 1.5)) / (1.5 * np.diff(ends))
        return {
            "force": force_error(contacts, approach, 2.0 / 3.0, force),
            "contact radius": contact_radius / a - 1.0,
            "largest pressure": peak / p_max - 1.0,
            "at the axis": np.abs(axis / means - 1.0).max(),
        }

    found = check_errors(errors, {
        "force": (1e-4, None), "contact radius": (1e-3, 1.2, EXTRAPOLATION),
        "largest pressure": (1e-3, None), "at the axis": (1e-3, None),
    })  # fmt: skip
    # of first order at least: where in an element contact ends differs from mesh to mesh
    assert all(one["force"] < 0.008 / n for one, n in zip(found, (32, 64, 128), strict=True))


def test_cone(comm):
    slope, reach = 0.1, 1.6
    approach = 0.5 * math.pi * slope  # of contact radius 1
    profile = np.array([[0.0, 0.0], [reach, reach * slope]])
    known = 2.0 * MODULUS * approach**2 / (math.pi * slope)
    for n in (32, 64, 128):
        _, contacts = indented(profile, approach, n, comm)
        assert abs(force_error(contacts, approach, 0.5, known)) < min(0.008 / n, 1e-4 * 128 / n)
