"""A body condensed to its contact line: compliance in the normal direction and in torsion.

Both are computed at Young's modulus 1 and scale by 1/E, so one assembly serves every modulus,
load, speed and wear law at the same shape and Poisson's ratio. Of layers the ratio of their modulus
to that of the body itself counts.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.bem.assembly import assemble
from ringwear_par.elasticity.bem.boundary import BoundaryMesh, zone_meshes
from ringwear_par.elasticity.bem.quadrature import quadrature
from ringwear_par.elasticity.bem.solve import Solution, solve_systems, solved_on_one_rank
from ringwear_par.elasticity.bem.systems import (
    BoundaryConditions,
    DofMap,
    Zone,
    number_dofs,
)
from ringwear_par.elasticity.mesh import ContactLine, Mesh, obliquity
from ringwear_par.elasticity.sections import Body, Grip, Material


@dataclass(frozen=True)
class BodyCost:
    """What boundary elements took: kernels evaluated on all ranks, wall seconds on this rank."""

    kernel_evaluations: int = 0
    seconds_assembly: float = 0.0
    seconds_solution: float = 0.0

    def __add__(self, other: "BodyCost") -> "BodyCost":
        return BodyCost(
            self.kernel_evaluations + other.kernel_evaluations,
            self.seconds_assembly + other.seconds_assembly,
            self.seconds_solution + other.seconds_solution,
        )


@dataclass(frozen=True)
class Response:
    """Boundary values for each load, on every rank, zone after zone."""

    #: (wanted nodes, 3, n_loads) float, mm at E = 1
    displacement: FloatArray
    #: (wanted elements, 3, n_loads) float, MPa, unknown ones; 0 where they were given
    traction: FloatArray
    #: what they took
    cost: BodyCost


@dataclass(frozen=True)
class Compliance:
    """Compliance of a body's contact line at Young's modulus 1."""

    #: (n, n) float, mm/MPa; what element i gives way along the axis, -(u_z - t u_r) with the slope
    #: t, under unit pressure on element j
    normal: FloatArray
    #: (n, n) float, mm/MPa; circumferential displacement under unit shear
    torsion: FloatArray
    #: (n,) float, mm^2; axial force on the fixed face per unit pressure. Equilibrium asks for the
    #: contact element's projected area.
    force_reaction: FloatArray
    #: (n,) float, mm^3; torque on the fixed face per unit shear
    torque_reaction: FloatArray
    #: what they took
    cost: BodyCost


def boundary_conditions(
    boundary: BoundaryMesh, grip: Grip, slope: FloatArray | None = None
) -> BoundaryConditions:
    """Return conditions of a zone in contact: fixed face, a right-hand side per contact element.

    Right-hand side j is unit pressure along the common normal (normal system) and unit
    circumferential traction (torsion) on the true area of contact element j. Tractions are scaled
    by dr/ds of the element, so that the axial force is the projected area times the pressure
    whatever its own slope. "clamped" fixes u_r, u_z and u_theta, "platen" leaves u_r free of
    traction.

    Parameters
    ----------
    slope : (n,) float, tan alpha of the common normal in the body's own frame, see ``pair_slope``;
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
class BoundaryProblem:
    """Equation (5) of a body, and what is wanted of its solution."""

    #: the body
    zones: tuple[Zone, ...]
    #: relative accuracy of the element integrals
    tolerance: float
    #: of each zone, whose displacements and whose tractions are wanted
    nodes: tuple[IntArray, ...]
    elements: tuple[IntArray, ...]


def solve_body(
    boundary: BoundaryMesh,
    conditions: BoundaryConditions,
    poisson: float,
    tolerance: float,
    nodes: IntArray,
    elements: IntArray,
    comm: MPI.Comm,
) -> Response:
    """Solve (5) of one zone; return some nodes' displacements and some elements' tractions.

    Collective on comm.
    """
    zone = Zone(boundary, conditions, Material(1.0, poisson))
    return solve_bodies([BoundaryProblem((zone,), tolerance, (nodes,), (elements,))], comm)[0]


def solve_bodies(problems: Sequence[BoundaryProblem], comm: MPI.Comm) -> list[Response]:
    """Solve (5) of several bodies: at once where ranks can share their systems. Collective."""
    largest = max(
        2 * sum(len(zone.boundary.nodes) for zone in problem.zones) for problem in problems
    )
    if comm.size > 1 and solved_on_one_rank(largest, comm.size):
        return _solve(problems, comm)
    # one after another: not all in memory
    return [_solve([problem], comm)[0] for problem in problems]


def _solve(problems: Sequence[BoundaryProblem], comm: MPI.Comm) -> list[Response]:
    """Assemble the systems of bodies, then solve them. Collective on comm."""
    started = time.perf_counter()
    dofs = [number_dofs(problem.zones) for problem in problems]
    bodies = [
        assemble(problem.zones, numbers, quadrature(problem.tolerance), comm)
        for problem, numbers in zip(problems, dofs, strict=True)
    ]
    assembled = time.perf_counter()
    solutions = solve_systems([s for body in bodies for s in (body.normal, body.torsion)], comm)
    values = [
        _wanted(problem, numbers, solutions[2 * i], solutions[2 * i + 1], comm)
        for i, (problem, numbers) in enumerate(zip(problems, dofs, strict=True))
    ]
    evaluations = [comm.allreduce(body.kernel_evaluations) for body in bodies]
    seconds = (time.perf_counter() - assembled) / len(bodies)
    return [
        Response(*response, BodyCost(count, (assembled - started) / len(bodies), seconds))
        for response, count in zip(values, evaluations, strict=True)
    ]


def _wanted(
    problem: BoundaryProblem,
    numbers: Sequence[DofMap],
    normal: Solution,
    torsion: Solution,
    comm: MPI.Comm,
) -> tuple[FloatArray, FloatArray]:
    """Return the displacements and tractions that a problem asks for. Collective on comm."""
    nodes, elements = problem.nodes, problem.elements
    columns = [
        np.concatenate([dofs.displacement[at] for dofs, at in zip(numbers, nodes, strict=True)]),
        np.concatenate([dofs.traction[at] for dofs, at in zip(numbers, elements, strict=True)]),
    ]
    sign = np.concatenate([dofs.sign[at] for dofs, at in zip(numbers, elements, strict=True)])
    n_loads = problem.zones[0].conditions.n_loads
    displacement, traction = (np.zeros((*dofs.shape, n_loads)) for dofs in columns)
    for c, (x, start) in enumerate((normal, normal, torsion)):
        for target, dofs in zip((displacement, traction), columns, strict=True):
            local = dofs[:, c] - start
            computed = (dofs[:, c] >= 0) & (local >= 0) & (local < len(x))
            target[computed, c] = x[local[computed]]
    for array in (displacement, traction):  # each entry is known to one rank: the sum is exact
        comm.Allreduce(MPI.IN_PLACE, array, MPI.SUM)
    return displacement, traction * sign[:, None, None]


@dataclass(frozen=True)
class BoundaryResponse:
    """Values on the whole boundary of a zone, for loads on each contact element of its body.

    At Young's modulus 1 of the body itself.

    Load j is unit pressure (components r and z) and unit circumferential traction (theta) on
    contact element j, see ``boundary_conditions``.
    """

    #: the boundary elements
    boundary: BoundaryMesh
    #: (m, 3, n) float, mm/MPa, of every node in r, z and theta
    displacement: FloatArray
    #: (k, 3, n) float, MPa/MPa, on every element, the loads included
    traction: FloatArray
    #: of the zone, its modulus over that of the body itself
    material: Material


def boundary_responses(
    body: Body,
    line: ContactLine,
    mesh: Mesh,
    comm: MPI.Comm,
    worn: FloatArray | None = None,
    slope: FloatArray | None = None,
    *,
    fine: bool = False,
) -> list[BoundaryResponse]:
    """Return displacements and tractions on the boundaries of all zones, in the body's own frame.

    Collective on comm. ``worn`` and ``fine`` are those of ``zone_meshes``, ``slope`` of
    ``boundary_conditions``.
    """
    zones = body_zones(body, line, mesh, worn, slope, fine=fine)
    counts = [(len(zone.boundary.nodes), len(zone.boundary.elements)) for zone in zones]
    nodes, elements = (tuple(map(np.arange, numbers)) for numbers in zip(*counts, strict=True))
    problem = BoundaryProblem(zones, mesh.quadrature_tolerance, nodes, elements)
    response = solve_bodies([problem], comm)[0]
    responses, after = [], np.cumsum(counts, axis=0)[:-1]
    displacements = np.split(response.displacement, after[:, 0])
    tractions = np.split(response.traction, after[:, 1])
    for zone, displacement, traction in zip(zones, displacements, tractions, strict=True):
        conditions = zone.conditions
        e, c = np.nonzero(conditions.load >= 0)
        traction[e, c, conditions.load[e, c]] += conditions.traction[e, c]
        responses.append(BoundaryResponse(zone.boundary, displacement, traction, zone.material))
    return responses


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
    return replace(
        response,
        boundary=boundary._replace(nodes=nodes, elements=boundary.elements[:, ::-1].copy()),
        displacement=signs * response.displacement,
        traction=signs * response.traction,
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

    Collective on comm. ``worn`` is that of ``zone_meshes``, ``slope`` of ``boundary_conditions``.
    """
    return compliances([body], line, mesh, comm, [slope], [worn])[0]


def compliances(
    bodies: Sequence[Body],
    line: ContactLine,
    mesh: Mesh,
    comm: MPI.Comm,
    slopes: Sequence[FloatArray | None],
    worn: Sequence[FloatArray | None],
) -> list[Compliance]:
    """Return the compliances of bodies, as ``compliance`` does of one. Collective on comm.

    Ranks share their systems.
    """
    problems = [
        contact_problem(body, line, mesh, wear, slope)
        for body, wear, slope in zip(bodies, worn, slopes, strict=True)
    ]
    responses = solve_bodies(problems, comm) if problems else []
    return [
        condense(problem, response, slope)
        for problem, response, slope in zip(problems, responses, slopes, strict=True)
    ]


def body_zones(
    body: Body,
    line: ContactLine,
    mesh: Mesh,
    worn: FloatArray | None = None,
    slope: FloatArray | None = None,
    *,
    fine: bool = False,
) -> tuple[Zone, ...]:
    """Return the zones of a body in contact, from the contact face downwards. Not collective.

    Arguments are those of ``compliance``, and of ``zone_meshes``.
    """
    meshes = zone_meshes(body.section, line, mesh, worn, fine=fine)
    slopes = slope, *(None for _ in body.layers)  # the first zone alone has the contact
    return tuple(
        Zone(boundary, boundary_conditions(boundary, body.grip, zone_slope), material)
        for boundary, zone_slope, material in zip(meshes, slopes, body.relative, strict=True)
    )


def contact_problem(
    body: Body, line: ContactLine, mesh: Mesh, worn: FloatArray | None, slope: FloatArray | None
) -> BoundaryProblem:
    """Return a body under unit loads on its contact elements. Not collective.

    Displacements are collocated at the elements' mid-points; taking them from the end nodes would
    give pressures of alternating sign almost no displacement.
    """
    zones = body_zones(body, line, mesh, worn, slope)
    boundaries = [zone.boundary for zone in zones]
    return BoundaryProblem(
        zones,
        mesh.quadrature_tolerance,
        tuple(boundary.elements[boundary.contact, 1] for boundary in boundaries),
        tuple(boundary.fixed for boundary in boundaries),
    )


def condense(
    problem: BoundaryProblem, response: Response, slope: FloatArray | None = None
) -> Compliance:
    """Return the compliance of a solved body. Not collective.

    Parameters
    ----------
    problem : of ``contact_problem``.
    slope : that of ``boundary_conditions``.
    """
    boundary = problem.zones[-1].boundary
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
        cost=response.cost,
    )
