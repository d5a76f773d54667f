"""A body condensed to its contact line: compliance in the normal direction and in torsion.

Both are computed at Young's modulus 1 and scale by 1/E, so one assembly serves every modulus,
load, speed and wear law at the same shape and Poisson's ratio. Of layers the ratio of their modulus
to that of the body itself counts.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.boundary import BoundaryMesh, zone_meshes
from ringwear_par.elasticity.bem.quadrature import quadrature
from ringwear_par.elasticity.bem.solve import solve, solved_on_one_rank
from ringwear_par.elasticity.bem.systems import BoundaryConditions, Zone, assemble, number_dofs
from ringwear_par.elasticity.mesh import ContactLine, Mesh, obliquity
from ringwear_par.elasticity.sections import Body, BodyName, Grip, Material
from ringwear_par.parallel import together


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
    #: (2,) float, s, wall time on this rank that assembly and solution took
    seconds: FloatArray


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
class BoundaryResponse:
    """Values on the whole boundary of a zone, for each load of its body.

    At Young's modulus 1 of the body itself. In contact, load j is unit pressure (components r and
    z) and unit circumferential traction (theta) on contact element j, see ``boundary_conditions``.
    """

    #: the boundary elements
    boundary: BoundaryMesh
    #: (m, 3, n) float, mm/MPa, of every node in r, z and theta
    displacement: FloatArray
    #: (k, 3, n) float, MPa/MPa, on every element, the loads included
    traction: FloatArray
    #: of the zone, its modulus over that of the body itself
    material: Material


def solve_zones(
    zones: Sequence[Zone], tolerance: float, comm: MPI.Comm
) -> tuple[list[BoundaryResponse], FloatArray]:
    """Solve eq. (5) of a body; return the response of each zone, and seconds as in ``Compliance``.

    Collective on comm, the same on all ranks.

    Parameters
    ----------
    zones : from the contact face downwards, each bonded to the next.
    tolerance : relative accuracy of the element integrals.

    Raises
    ------
    ComputationError : elements are too close to each other, or a factorisation failed.
    """
    started = time.perf_counter()
    dofs = number_dofs(zones)
    unknowns = 2 * sum(len(zone.boundary.nodes) for zone in zones)
    ranks = MPI.COMM_SELF if solved_on_one_rank(unknowns, comm.size) else comm
    with together(comm):
        systems = assemble(zones, dofs, quadrature(tolerance), ranks)
    assembled = time.perf_counter()
    with together(comm):
        normal, torsion = (solve(system, ranks) for system in systems)
    responses, n_loads = [], normal.shape[1]
    for zone, numbers in zip(zones, dofs, strict=True):
        load, given = zone.conditions.load, zone.conditions.traction
        displacement, traction = (
            np.zeros((*of.shape, n_loads)) for of in (numbers.displacement, numbers.traction)
        )
        for c, x in enumerate((normal, normal, torsion)):
            for values, of in ((displacement, numbers.displacement), (traction, numbers.traction)):
                computed = of[:, c] >= 0
                values[computed, c] = x[of[computed, c]]
        traction *= numbers.sign[:, None, None]
        e, along = np.nonzero(load >= 0)
        traction[e, along, load[e, along]] += given[e, along]
        responses.append(BoundaryResponse(zone.boundary, displacement, traction, zone.material))
    return responses, np.array([assembled - started, time.perf_counter() - assembled])


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

    ``worn`` and ``fine`` are those of ``zone_meshes``, ``slope`` of ``boundary_conditions``.
    """
    meshes = zone_meshes(body.section, line, mesh, worn, fine=fine)
    slopes = slope, *(None for _ in body.layers)  # the first zone alone has the contact
    return tuple(
        Zone(boundary, boundary_conditions(boundary, body.grip, zone_slope), material)
        for boundary, zone_slope, material in zip(meshes, slopes, body.relative, strict=True)
    )


def in_case_frame(response: BoundaryResponse, which: BodyName, plane: float) -> BoundaryResponse:
    """Return a boundary response in the frame of the case. Not collective.

    z is counted from the case's origin, ``plane`` (mm) being lower.z[1] or upper.z[0]. The upper
    body is mirrored back: u_z and t_z change sign, and elements change direction, so that their
    outward normals still lie to the right. Unit shear becomes what unit friction does: it drags
    lower towards +theta and holds upper back towards -theta, so that u_theta and t_theta of the
    upper body change sign too. Multiplied by 1/E (displacements), p (r, z) and mu p (theta) and
    summed over the loads, these are the fields of the case.
    """
    boundary, upward = response.boundary, 1.0 if which == "lower" else -1.0
    nodes = boundary.nodes * [1.0, upward] + [0.0, plane]
    elements = boundary.elements if which == "lower" else boundary.elements[:, ::-1].copy()
    signs = np.array([1.0, upward, upward])[:, None]
    return replace(
        response,
        boundary=boundary._replace(nodes=nodes, elements=elements),
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

    Displacements are collocated at the elements' mid-points; taking them from the end nodes would
    give pressures of alternating sign almost no displacement. Collective on comm. ``worn`` is that
    of ``zone_meshes``, ``slope`` of ``boundary_conditions``.
    """
    zones = body_zones(body, line, mesh, worn, slope)
    responses, seconds = solve_zones(zones, mesh.quadrature_tolerance, comm)
    top, base = responses[0], responses[-1]
    middle = top.boundary.elements[top.boundary.contact, 1]
    radial, axial, turning = np.moveaxis(top.displacement[middle], 1, 0)
    held = base.boundary.fixed
    inner, _, outer = base.boundary.nodes[base.boundary.elements[held], 0].T
    area, moment = np.pi * (outer**2 - inner**2), 2.0 * np.pi / 3.0 * (outer**3 - inner**3)
    return Compliance(
        normal=-axial if slope is None else slope[:, None] * radial - axial,
        torsion=turning,
        force_reaction=area @ base.traction[held, 1],
        torque_reaction=-(moment @ base.traction[held, 2]),
        seconds=seconds,
    )
