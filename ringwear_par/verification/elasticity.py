"""Bodies alone against exact fields: bar, Lame, torsion, and the closure of the kernels."""

import math
from collections.abc import Iterator
from functools import partial

import numpy as np
from mpi4py import MPI

from ringwear_par.elasticity.bem.body import boundary_conditions, compliance, solve_body
from ringwear_par.elasticity.bem.boundary import boundary_mesh
from ringwear_par.elasticity.bem.kernels import ring_kernels
from ringwear_par.elasticity.bem.systems import BoundaryConditions
from ringwear_par.elasticity.geometry.mesh import ContactLine, Mesh, contact_line
from ringwear_par.elasticity.geometry.sections import Body, Section
from ringwear_par.verification import reference
from ringwear_par.verification.check import NU, Check, converging


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


def elasticity_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare bodies under simple loads with their exact solutions. Collective on comm."""
    yield Check("traction kernel: rigid modes, sources inside and outside", (1,),
                (closure_error(),), 1e-12, kind="identity")  # fmt: skip
    yield converging("bar with free sides: u_z", partial(bar_error, comm=comm), 1e-6)
    yield converging("Lame, plane strain: u_r of the bore", partial(lame_error, comm=comm), 1e-6)
    yield converging(
        "torsion of a hollow cylinder: u_theta", partial(torsion_error, comm=comm), 1e-3
    )
