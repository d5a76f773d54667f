"""A body condensed to its contact line: compliance in the normal direction and in torsion.

Both are computed at Young's modulus 1 and scale by 1/E, so one assembly serves every modulus,
load, speed and wear law at the same shape and Poisson's ratio.
"""

import time
from dataclasses import dataclass
from typing import Literal

import numpy as np
from mpi4py import MPI

from ringwear_par.assembly import Conditions, Unknowns, assemble, number_unknowns
from ringwear_par.dense import solve_rows
from ringwear_par.geometry import (
    ContactLine,
    Contour,
    FloatArray,
    IntArray,
    Mesh,
    Section,
    contour,
)
from ringwear_par.quadrature import quadrature

Grip = Literal["clamped", "platen"]


@dataclass(frozen=True)
class Response:
    """Boundary values for each load, on every rank.

    Parameters
    ----------
    displacement : (wanted nodes, 3, n_loads) float, mm at E = 1.
    traction : (wanted elements, 3, n_loads) float, MPa, unknown ones; 0 where they were given.
    kernel_evaluations : on all ranks together.
    seconds_assembly, seconds_solution : wall time on this rank.
    """

    displacement: FloatArray
    traction: FloatArray
    kernel_evaluations: int
    seconds_assembly: float
    seconds_solution: float


@dataclass(frozen=True)
class Compliance:
    """Compliance of a body's contact line at Young's modulus 1.

    Parameters
    ----------
    normal : (n, n) float, mm/MPa; approach of element i under unit pressure on element j.
    torsion : (n, n) float, mm/MPa; circumferential displacement under unit shear.
    force_reaction : (n,) float, mm^2; axial force on the held face per unit pressure. Equilibrium
        asks for the contact element's area.
    torque_reaction : (n,) float, mm^3; torque on the held face per unit shear.
    response : the work and the times.
    """

    normal: FloatArray
    torsion: FloatArray
    force_reaction: FloatArray
    torque_reaction: FloatArray
    response: Response


def ring_conditions(body: Contour, grip: Grip) -> Conditions:
    """Return the conditions of a ring: held face, one right-hand side per contact element.

    Right-hand side j is unit pressure (normal system) and unit circumferential traction (torsion)
    on contact element j, both per area projected on the contact plane: the tractions are along z
    and theta whatever the slope of the element, dr/ds as large as the pressure, so that the force
    is area times pressure. "clamped" holds u_r, u_z and u_theta, "platen" leaves u_r free of
    traction.
    """
    k, n = len(body.elements), len(body.contact)
    held = np.zeros((k, 3), dtype=bool)
    held[body.held] = [grip == "clamped", True, True]
    load = np.full((k, 3), -1)
    traction = np.zeros((k, 3))
    load[body.contact, 1:] = np.arange(n)[:, None]
    along = body.nodes[body.elements[body.contact, 2]] - body.nodes[body.elements[body.contact, 0]]
    projected = np.abs(along[:, 0]) / np.hypot(*along.T)
    traction[body.contact, 1:] = projected[:, None] * [-1.0, 1.0]
    return Conditions(held, load, traction, n)


def solve_body(
    body: Contour,
    conditions: Conditions,
    poisson: float,
    tolerance: float,
    nodes: IntArray,
    elements: IntArray,
    comm: MPI.Comm,
) -> Response:
    """Solve (5) for all right-hand sides; return some nodes' displacements, elements' tractions.

    Collective on comm.
    """
    t0 = time.perf_counter()
    unknowns: Unknowns = number_unknowns(body, conditions)
    rows = assemble(body, conditions, unknowns, poisson, quadrature(tolerance), comm)
    t1 = time.perf_counter()
    displacement = np.zeros((len(nodes), 3, conditions.n_loads))
    traction = np.zeros((len(elements), 3, conditions.n_loads))
    for system, components in ((rows.normal, (0, 1)), (rows.torsion, (2,))):
        x, start = solve_rows(system, comm)
        for c in components:
            for target, column in (
                (displacement, unknowns.displacement[nodes, c]),
                (traction, unknowns.traction[elements, c]),
            ):
                local = column - start
                here = (column >= 0) & (local >= 0) & (local < len(x))
                target[here, c] = x[local[here]]
    for array in (displacement, traction):  # each entry is known to one rank: the sum is exact
        comm.Allreduce(MPI.IN_PLACE, array, MPI.SUM)
    evaluations = comm.allreduce(rows.kernel_evaluations)
    t2 = time.perf_counter()
    return Response(displacement, traction, evaluations, t1 - t0, t2 - t1)


def compliance(
    section: Section, line: ContactLine, poisson: float, grip: Grip, mesh: Mesh, comm: MPI.Comm
) -> Compliance:
    """Return the compliance of a body's contact line.

    Collective on comm. Displacements are collocated at the elements' mid-points; taking them from
    the end nodes would give pressures of alternating sign almost no displacement.
    """
    body = contour(section, line, mesh)
    response = solve_body(
        body, ring_conditions(body, grip), poisson, mesh.quadrature_tolerance,
        body.elements[body.contact, 1], body.held, comm,
    )  # fmt: skip
    return condense(body, response)


def condense(body: Contour, response: Response) -> Compliance:
    """Return the compliance of a solved body. Not collective.

    Parameters
    ----------
    response : displacements at the contact elements' mid-points, tractions of the held elements.
    """
    inner = body.nodes[body.elements[body.held, 0], 0]
    outer = body.nodes[body.elements[body.held, 2], 0]
    area = np.pi * (outer**2 - inner**2)
    moment = 2.0 * np.pi / 3.0 * (outer**3 - inner**3)
    return Compliance(
        normal=-response.displacement[:, 1],
        torsion=response.displacement[:, 2],
        force_reaction=area @ response.traction[:, 1],
        torque_reaction=-(moment @ response.traction[:, 2]),
        response=response,
    )
