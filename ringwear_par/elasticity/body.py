"""A body condensed to its contact line: compliance in the normal direction and in torsion.

Both are computed at Young's modulus 1 and scale by 1/E, so one assembly serves every modulus,
load, speed and wear law at the same shape and Poisson's ratio.
"""

import time
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.assembly import (
    Assembly,
    BoundaryConditions,
    DofMap,
    assemble,
    number_dofs,
)
from ringwear_par.elasticity.mesh import BoundaryMesh, ContactLine, Mesh, boundary_mesh
from ringwear_par.elasticity.quadrature import quadrature
from ringwear_par.elasticity.sections import Body, Grip
from ringwear_par.elasticity.slopes import obliquity
from ringwear_par.elasticity.solve import solve_rows


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
    normal : (n, n) float, mm/MPa; what element i gives way along the axis, -(u_z - t u_r) with the
        slope t, under unit pressure on element j.
    torsion : (n, n) float, mm/MPa; circumferential displacement under unit shear.
    force_reaction : (n,) float, mm^2; axial force on the fixed face per unit pressure. Equilibrium
        asks for the contact element's projected area.
    torque_reaction : (n,) float, mm^3; torque on the fixed face per unit shear.
    response : the work and the times.
    """

    normal: FloatArray
    torsion: FloatArray
    force_reaction: FloatArray
    torque_reaction: FloatArray
    response: Response


def boundary_conditions(
    boundary: BoundaryMesh, grip: Grip, slope: FloatArray | None = None
) -> BoundaryConditions:
    """Return those of a body in contact: fixed face, one right-hand side per contact element.

    Right-hand side j is unit pressure along the common normal (normal system) and unit
    circumferential traction (torsion) on the true area of contact element j. Tractions are scaled
    by dr/ds of the element, so that the axial force is the projected area times the pressure
    whatever its own slope. "clamped" fixes u_r, u_z and u_theta, "platen" leaves u_r free of
    traction.

    Parameters
    ----------
    slope : (n,) float, tan alpha of the common normal in the body's own frame, see ``slopes``;
        None: none.
    """
    k, n = len(boundary.elements), len(boundary.contact)
    slope = np.zeros(n) if slope is None else slope
    fixed = np.zeros((k, 3), dtype=bool)
    fixed[boundary.fixed] = [grip == "clamped", True, True]
    load = np.full((k, 3), -1)
    traction = np.zeros((k, 3))
    load[boundary.contact] = np.arange(n)[:, None]
    ends = boundary.nodes[boundary.elements[boundary.contact]]
    along = ends[:, 2] - ends[:, 0]
    projected = np.abs(along[:, 0]) / np.hypot(*along.T)
    directions = np.stack([slope, -np.ones(n), obliquity(slope)], axis=1)
    traction[boundary.contact] = projected[:, None] * directions
    return BoundaryConditions(fixed, load, traction, n)


def solve_body(
    boundary: BoundaryMesh,
    conditions: BoundaryConditions,
    poisson: float,
    tolerance: float,
    nodes: IntArray,
    elements: IntArray,
    comm: MPI.Comm,
) -> Response:
    """Solve (5) for all right-hand sides; return some nodes' displacements, elements' tractions.

    Collective on comm.
    """
    dofs = number_dofs(boundary, conditions)
    started = time.perf_counter()
    rows = assemble(boundary, conditions, dofs, poisson, quadrature(tolerance), comm)
    seconds = time.perf_counter() - started
    return solve_assembled(rows, dofs, nodes, elements, seconds, comm)


def solve_assembled(
    rows: Assembly,
    dofs: DofMap,
    nodes: IntArray,
    elements: IntArray,
    seconds: float,
    comm: MPI.Comm,
) -> Response:
    """Solve two assembled systems, as ``solve_body`` does; ``seconds`` is what assembly took.

    Collective on comm.
    """
    started = time.perf_counter()
    n_loads = rows.normal.loads.shape[1]
    displacement = np.zeros((len(nodes), 3, n_loads))
    traction = np.zeros((len(elements), 3, n_loads))
    for system, components in ((rows.normal, (0, 1)), (rows.torsion, (2,))):
        x, start = solve_rows(system, comm)
        for c in components:
            for target, column in (
                (displacement, dofs.displacement[nodes, c]),
                (traction, dofs.traction[elements, c]),
            ):
                local = column - start
                here = (column >= 0) & (local >= 0) & (local < len(x))
                target[here, c] = x[local[here]]
    for array in (displacement, traction):  # each entry is known to one rank: the sum is exact
        comm.Allreduce(MPI.IN_PLACE, array, MPI.SUM)
    evaluations = comm.allreduce(rows.kernel_evaluations)
    return Response(displacement, traction, evaluations, seconds, time.perf_counter() - started)


@dataclass(frozen=True)
class BoundaryResponse:
    """Values on the whole boundary, at Young's modulus 1, for loads on each contact element.

    Load j is unit pressure (components r and z) and unit circumferential traction (theta) on
    contact element j, see ``boundary_conditions``.

    Parameters
    ----------
    boundary : the boundary elements.
    displacement : (m, 3, n) float, mm/MPa, of every node in r, z and theta.
    traction : (k, 3, n) float, MPa/MPa, on every element, the loads included.
    """

    boundary: BoundaryMesh
    displacement: FloatArray
    traction: FloatArray


def boundary_response(
    body: Body,
    line: ContactLine,
    mesh: Mesh,
    comm: MPI.Comm,
    worn: FloatArray | None = None,
    slope: FloatArray | None = None,
) -> BoundaryResponse:
    """Return displacements and tractions on the whole boundary, in the body's own frame.

    Collective on comm. ``worn`` is that of ``boundary_mesh``, ``slope`` of ``boundary_conditions``.
    """
    boundary = boundary_mesh(body.section, line, mesh, worn)
    conditions = boundary_conditions(boundary, body.grip, slope)
    nodes, elements = np.arange(len(boundary.nodes)), np.arange(len(boundary.elements))
    response = solve_body(
        boundary, conditions, body.poisson, mesh.quadrature_tolerance, nodes, elements, comm
    )
    e, c = np.nonzero(conditions.load >= 0)
    response.traction[e, c, conditions.load[e, c]] += conditions.traction[e, c]
    return BoundaryResponse(boundary, response.displacement, response.traction)


def in_case_frame(
    response: BoundaryResponse, which: Literal["lower", "upper"], plane: float
) -> BoundaryResponse:
    """Return a boundary response in the frame of the case. Not collective.

    z is counted from the case's origin, ``plane`` (mm) being lower.z[1] or upper.z[0]. The upper
    body is mirrored back: u_z and t_z change sign, and elements change direction, so that their
    outward normals still lie to the right. Unit shear becomes what unit friction does: it drags
    lower towards +theta and holds upper back towards -theta, so that u_theta and t_theta of the
    upper body change sign too. Multiplied by 1/E (displacements), p (r, z) and mu p (theta) and
    summed over the loads, these are the fields of the case.
    """
    boundary, nodes = response.boundary, response.boundary.nodes.copy()
    if which == "lower":
        nodes[:, 1] += plane
        return replace(response, boundary=boundary._replace(nodes=nodes))
    nodes[:, 1] = plane - nodes[:, 1]
    signs = np.array([1.0, -1.0, -1.0])[None, :, None]
    return BoundaryResponse(
        boundary._replace(nodes=nodes, elements=boundary.elements[:, ::-1].copy()),
        signs * response.displacement,
        signs * response.traction,
    )


def compliance(
    body: Body,
    line: ContactLine,
    mesh: Mesh,
    comm: MPI.Comm,
    worn: FloatArray | None = None,
    slope: FloatArray | None = None,
) -> Compliance:
    """Return the compliance of a body's contact line.

    Collective on comm. Displacements are collocated at the elements' mid-points; taking them from
    the end nodes would give pressures of alternating sign almost no displacement. ``worn`` is that
    of ``boundary_mesh``, ``slope`` of ``boundary_conditions``.
    """
    boundary = boundary_mesh(body.section, line, mesh, worn)
    conditions = boundary_conditions(boundary, body.grip, slope)
    response = solve_body(
        boundary, conditions, body.poisson, mesh.quadrature_tolerance,
        boundary.elements[boundary.contact, 1], boundary.fixed, comm,
    )  # fmt: skip
    return condense(boundary, response, slope)


def condense(
    boundary: BoundaryMesh, response: Response, slope: FloatArray | None = None
) -> Compliance:
    """Return the compliance of a solved body. Not collective.

    Parameters
    ----------
    response : displacements at the contact elements' mid-points, tractions of the fixed elements.
    slope : that of ``boundary_conditions``.
    """
    radial, axial = response.displacement[:, 0], response.displacement[:, 1]
    inner = boundary.nodes[boundary.elements[boundary.fixed, 0], 0]
    outer = boundary.nodes[boundary.elements[boundary.fixed, 2], 0]
    area = np.pi * (outer**2 - inner**2)
    moment = 2.0 * np.pi / 3.0 * (outer**3 - inner**3)
    return Compliance(
        normal=-axial if slope is None else slope[:, None] * radial - axial,
        torsion=response.displacement[:, 2],
        force_reaction=area @ response.traction[:, 1],
        torque_reaction=-(moment @ response.traction[:, 2]),
        response=response,
    )
