"""A body condensed to its contact line: compliance in the normal direction and in torsion.

Both are computed at Young's modulus 1 and scale by 1/E, so one assembly serves every modulus,
load, speed and wear law at the same shape and Poisson's ratio.
"""

import time
from collections.abc import Sequence
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
from ringwear_par.elasticity.solve import solve_systems, solved_whole


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


@dataclass(frozen=True)
class Problem:
    """Equation (5) of a body, and what is wanted of its solution.

    Parameters
    ----------
    boundary, conditions, poisson : the body.
    tolerance : relative accuracy of the element integrals.
    nodes, elements : whose displacements and whose tractions are wanted.
    """

    boundary: BoundaryMesh
    conditions: BoundaryConditions
    poisson: float
    tolerance: float
    nodes: IntArray
    elements: IntArray


@dataclass(frozen=True)
class Assembled:
    """The assembled systems of a body, and what is wanted of their solution as of ``Problem``."""

    rows: Assembly
    dofs: DofMap
    nodes: IntArray
    elements: IntArray
    seconds: float


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
    problem = Problem(boundary, conditions, poisson, tolerance, nodes, elements)
    return solve_bodies([problem], comm)[0]


def solve_bodies(problems: Sequence[Problem], comm: MPI.Comm) -> list[Response]:
    """Solve (5) of several bodies: at once where ranks can share their systems. Collective."""
    largest = max(2 * len(problem.boundary.nodes) for problem in problems)
    if comm.size > 1 and solved_whole(largest, comm.size):
        return solve_assembled([_assembled(problem, comm) for problem in problems], comm)
    # one after another: not all in memory
    return [solve_assembled([_assembled(problem, comm)], comm)[0] for problem in problems]


def _assembled(problem: Problem, comm: MPI.Comm) -> Assembled:
    dofs = number_dofs(problem.boundary, problem.conditions)
    started = time.perf_counter()
    rows = assemble(
        problem.boundary, problem.conditions, dofs, problem.poisson,
        quadrature(problem.tolerance), comm,
    )  # fmt: skip
    seconds = time.perf_counter() - started
    return Assembled(rows, dofs, problem.nodes, problem.elements, seconds)


def solve_assembled(bodies: Sequence[Assembled], comm: MPI.Comm) -> list[Response]:
    """Solve the assembled systems of bodies. Collective on comm."""
    started = time.perf_counter()
    solutions = solve_systems(
        [system for body in bodies for system in (body.rows.normal, body.rows.torsion)], comm
    )
    found = []
    for i, body in enumerate(bodies):
        n_loads = body.rows.normal.loads.shape[1]
        displacement = np.zeros((len(body.nodes), 3, n_loads))
        traction = np.zeros((len(body.elements), 3, n_loads))
        for (x, start), components in zip(
            solutions[2 * i : 2 * i + 2], ((0, 1), (2,)), strict=True
        ):
            for c in components:
                for target, column in (
                    (displacement, body.dofs.displacement[body.nodes, c]),
                    (traction, body.dofs.traction[body.elements, c]),
                ):
                    local = column - start
                    here = (column >= 0) & (local >= 0) & (local < len(x))
                    target[here, c] = x[local[here]]
        for array in (displacement, traction):  # each entry is known to one rank: the sum is exact
            comm.Allreduce(MPI.IN_PLACE, array, MPI.SUM)
        evaluations = comm.allreduce(body.rows.kernel_evaluations)
        found.append((displacement, traction, evaluations, body.seconds))
    seconds = (time.perf_counter() - started) / len(bodies)
    return [Response(*each, seconds) for each in found]


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

    Collective on comm. ``worn`` is that of ``boundary_mesh``, ``slope`` of ``boundary_conditions``.
    """
    problem = _contact_problem(body, line, mesh, worn, slope)
    return condense(problem.boundary, solve_bodies([problem], comm)[0], slope)


def compliances(
    bodies: Sequence[Body],
    line: ContactLine,
    mesh: Mesh,
    comm: MPI.Comm,
    slopes: Sequence[FloatArray],
) -> list[Compliance]:
    """Return the compliances of unworn bodies, as ``compliance`` does of one. Collective on comm.

    Ranks share their systems.
    """
    problems = [
        _contact_problem(body, line, mesh, None, slope)
        for body, slope in zip(bodies, slopes, strict=True)
    ]
    responses = solve_bodies(problems, comm)
    return [
        condense(problem.boundary, response, slope)
        for problem, response, slope in zip(problems, responses, slopes, strict=True)
    ]


def _contact_problem(
    body: Body, line: ContactLine, mesh: Mesh, worn: FloatArray | None, slope: FloatArray | None
) -> Problem:
    """Return a body under unit loads on its contact elements.

    Displacements are collocated at the elements' mid-points; taking them from the end nodes would
    give pressures of alternating sign almost no displacement.
    """
    boundary = boundary_mesh(body.section, line, mesh, worn)
    return Problem(
        boundary,
        boundary_conditions(boundary, body.grip, slope),
        body.poisson,
        mesh.quadrature_tolerance,
        boundary.elements[boundary.contact, 1],
        boundary.fixed,
    )


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
