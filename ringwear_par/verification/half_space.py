"""Rigid annuli, spheres and cones on a half-space against their exact solutions.

Half-spaces are stood in for by solid discs of radius and height R, held at the base. What the
truncation adds to a compliance is proportional to 1/R, so results at R = 50 b and 100 b are
extrapolated to R = infinity; what is left, (b/R)^2 or less, is below the tolerances.
"""

import math
from collections.abc import Iterable, Iterator

import numpy as np
from mpi4py import MPI
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh, solve

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Load, Output, Ring, Stepping
from ringwear_par.contact.problem import ContactState
from ringwear_par.elasticity.bem.body import compliance
from ringwear_par.elasticity.bem.pair import symmetric
from ringwear_par.elasticity.mesh import ContactLine, Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Section
from ringwear_par.history.start import first_contact
from ringwear_par.verification import reference
from ringwear_par.verification.check import NU, SIZES, Check, checks_of

#: grading of the contact with a rigid edge
GRADED = 3.0


def _indentation(a: float, big_r: float, n: int, comm: MPI.Comm) -> dict[str, float]:
    """Return numbers of a rigid annulus on a disc of radius R, at E = 1, by their names."""
    contact, mesh = (a, 1.0), Mesh(n, grading=GRADED)
    line = contact_line(contact, mesh)
    disc = Body(Section((0.0, big_r), big_r), 1.0, NU, "clamped")
    unit = compliance(disc, line, mesh, comm)
    m = line.area
    normal = symmetric(line, unit.normal)
    p = solve(normal, m)
    worn = np.diag(m * line.arm)
    free = np.linalg.svd(m[None, :])[2][1:].T  # pressures that change, at constant force
    decay = (
        eigh(free.T @ worn @ free, free.T @ normal @ free, eigvals_only=True),
        eigh(worn, normal, eigvals_only=True),
    )
    modulus = reference.contact_modulus((1.0, NU))
    numbers = {
        _FORCE: float(m @ p),
        _MIDDLE: pressure_at(line, p, 0.5 * (a + 1.0)) * float(m.sum() / (m @ p)),
        _TORQUE: float((m * line.arm) @ solve(unit.torsion, line.arm)),
        **{
            name: float(rates[i]) / modulus
            for names, rates in zip(_DECAYS, decay, strict=True)
            for i, name in enumerate(names)
        },
    }
    if a == 0.0:
        exact = reference.flat_cylinder_pressure(1.0, line.edges[:5])
        ratios = p[:4] / float(m @ p / m.sum()) / exact
        numbers[_AXIS] = float(ratios[np.abs(ratios - 1.0).argmax()])
    return numbers


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
_FORCE, _MIDDLE, _AXIS = "force", "p(mid)/p(mean)", "p at the axis, worst of 4 elements"
_TORQUE = "disc turned on a half-space (Reissner-Sagoci): torque"
#: at a given force, and at a given approach
_DECAYS = [
    tuple(f"decay {i}, given {control}" for i in (1, 2)) for control in ("force", "approach")
]
#: tolerance, and accuracy of the reference
_ALLOWED = {
    _FORCE: (1e-4, 1e-6), _MIDDLE: (1e-3, 1e-5), _AXIS: (1e-3, Check.digits),
    _TORQUE: (1e-4, Check.digits), **dict.fromkeys(_DECAYS[0], (5e-4, 2e-4)),
    **dict.fromkeys(_DECAYS[1], (1e-3, 2e-4)),
}  # fmt: skip


def without_truncation(stiffnesses: Iterable[float]) -> float:
    """Return a stiffness for R = infinity from two R, one twice the other.

    Its inverse is linear in 1/R.
    """
    first, second = stiffnesses
    return 1.0 / (2.0 / second - 1.0 / first)


def half_space_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare rigid annuli and the turned disc with their half-space solutions."""
    modulus, shear = reference.contact_modulus((1.0, NU)), 0.5 / (1.0 + NU)
    decays = list(zip(_DECAYS, (reference.DECAY_FORCE, reference.DECAY_APPROACH), strict=True))
    for ratio, (force, middle) in {0.0: _CYLINDER, **reference.ANNULUS}.items():
        body = f"rigid flat annulus a/b = {ratio:g}" if ratio else "rigid flat cylinder"
        exact = {_FORCE: force * reference.flat_cylinder_force(modulus, 1.0, 1.0), _MIDDLE: middle}
        if not ratio:
            torque = reference.reissner_sagoci_torque(shear, 1.0, 1.0)
            exact |= {_AXIS: 1.0, _TORQUE: torque}
        if ratio == 0.5:
            exact |= {names[i]: rates[i] for i in (0, 1) for names, rates in decays}
        errors = []
        for n in SIZES:
            near, far = (_indentation(ratio, big_r, n, comm) for big_r in (50.0, 100.0))
            far |= {k: without_truncation((near[k], far[k])) for k in (_FORCE, *_DECAYS[1])}
            errors.append([far[name] / value - 1.0 for name, value in exact.items()])
        rows = [(name if name == _TORQUE else f"{body}: {name}", *_ALLOWED[name]) for name in exact]
        yield from checks_of(errors, rows)


#: radius of the sphere and slope of the cone; the approaches make the contact radius 1
_SPHERE, _CONE = 10.0, 0.1
#: radius of these bodies; errors depend on where in an element the contact ends
_REACH = 1.6
#: error of the extrapolation to R = infinity, of the order of (a/R)^2
_EXTRAPOLATION = 3e-5


def indented(profile: FloatArray, approach: float, big_r: float, n: int,
             comm: MPI.Comm) -> tuple[ContactLine, ContactState]:  # fmt: skip
    """Press a rigid body of revolution into a disc of radius R at E = 1. Collective on comm.

    The profile (m, 2) mm has radii of the body and depths of its face below its top; the disc is
    ``big_r`` mm in radius and height, its n contact elements are equal; the approach is in mm.
    """
    reach = float(profile[-1, 0])
    face = tuple((float(r), -float(z)) for r, z in profile)
    case = Case(
        Ring((0.0, big_r), (0.0, big_r), 1.0, NU, "clamped"),
        Ring((0.0, reach), (big_r, big_r + 2.0), 1e13, NU, "clamped", face),
        0.1, None, None, Load(0.0, displacement=approach), Stepping("implicit", 1.0, 1),
        Mesh(n, grading=1.0), Output(),
    )  # fmt: skip
    return case.line, first_contact(case, comm)


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
    all_errors: list[list[float]] = []
    for n in SIZES:
        forces, radii, peaks = [], [], []
        for big_r in (50.0, 100.0):
            line, state = indented(sphere, approach, big_r, n, comm)
            forces.append(state.force)
            x, y = line.r**2, state.pressure**2  # p^2 is linear in r^2
            outer, inner = (x > 0.5) & (x < 0.9), x < 0.25
            slope, at_axis = np.polyfit(x[outer], y[outer], 1)
            radii.append(math.sqrt(-at_axis / slope))
            peaks.append(math.sqrt(np.polyfit(x[inner], y[inner], 1)[1]))
        all_errors.append(
            [_indented_force(forces, approach, 2.0 / 3.0) / force - 1.0]
            + [(2.0 * v[1] - v[0]) / exact - 1.0 for v, exact in ((radii, a), (peaks, p_max))]
        )
    yield from checks_of(
        all_errors,
        (
            ("sphere (Hertz): force", 1e-4, _EXTRAPOLATION),
            ("sphere (Hertz): contact radius", 1e-3, _EXTRAPOLATION),
            ("sphere (Hertz): largest pressure", 1e-3, _EXTRAPOLATION),
        ),
    )
    approach = 0.5 * math.pi * _CONE
    cone = np.array([[0.0, 0.0], [_REACH, _REACH * _CONE]])
    all_errors.clear()
    for n in SIZES:
        forces = [indented(cone, approach, big_r, n, comm)[1].force for big_r in (50.0, 100.0)]
        exact = reference.cone_force(modulus, _CONE, approach)
        all_errors.append([_indented_force(forces, approach, 0.5) / exact - 1.0])
    yield from checks_of(all_errors, [("rigid cone: force", 1e-4, _EXTRAPOLATION)])
