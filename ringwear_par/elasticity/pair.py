"""Two bodies in contact: everything that a wear history needs to know of their elasticity."""

import os
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from scipy.linalg import eigh

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.body import Compliance, compliance
from ringwear_par.elasticity.mesh import ContactLine, Mesh, boundary_mesh, count_elements
from ringwear_par.elasticity.solve import has_scalapack
from ringwear_par.errors import ComputationError, InputError

#: elements wider than this share of their radius are near the axis
_NEAR_AXIS = 0.1


@dataclass(frozen=True)
class ContactPair:
    """Contact line of two bodies and its compliance.

    Parameters
    ----------
    line : the contact elements.
    stiffness : (n, n) float, mm^3/MPa, ``sym(diag(m) C)`` with C = C1/E1 + C2/E2.
    twist : (n,) float, mm/MPa; area mean of the circumferential displacement jump per unit
        circumferential traction on each element.
    symmetry_defect : largest ``|m C - (m C)'|`` over the largest ``|m C|``; vanishes with the mesh.
    force_reaction, torque_reaction : (2, n) float, mm^2 and mm^3; force and torque on the held
        faces of lower and upper per unit pressure and unit shear on each element. Equilibrium asks
        for the area, and area times arm; the difference vanishes with the mesh.
    """

    line: ContactLine
    stiffness: FloatArray
    twist: FloatArray
    symmetry_defect: float
    force_reaction: FloatArray
    torque_reaction: FloatArray


@dataclass(frozen=True)
class Operator:
    """What the boundary elements say of both bodies at Young's modulus 1.

    Moduli, load, speed, friction and wear laws scale it or come later, so that one operator serves
    every case of the same shape, mesh, Poisson's ratios and grip.

    Parameters
    ----------
    normal : (2, n, n) float, mm/MPa; approach under unit pressure, of lower and upper.
    twist : (2, n) float, mm^3/MPa; area integral of the circumferential displacement per unit
        circumferential traction.
    force_reaction, torque_reaction : (2, n) float, mm^2 and mm^3, as in ContactPair.
    """

    normal: FloatArray
    twist: FloatArray
    force_reaction: FloatArray
    torque_reaction: FloatArray


@dataclass(frozen=True)
class BodyCost:
    """What the boundary elements of both bodies took (wall seconds on this rank)."""

    kernel_evaluations: int
    seconds_assembly: float
    seconds_solution: float

    def __add__(self, other: "BodyCost") -> "BodyCost":
        return BodyCost(
            self.kernel_evaluations + other.kernel_evaluations,
            self.seconds_assembly + other.seconds_assembly,
            self.seconds_solution + other.seconds_solution,
        )

    @classmethod
    def of(cls, bodies: Sequence[Compliance]) -> "BodyCost":
        """Return what these bodies took together."""
        return cls(
            sum(body.response.kernel_evaluations for body in bodies),
            sum(body.response.seconds_assembly for body in bodies),
            sum(body.response.seconds_solution for body in bodies),
        )


def operator_key(case: Case) -> Hashable:
    """Return what the operator of a case depends on; equal for cases that can share it."""
    bodies = ((case.section(ring), ring.poisson, ring.grip) for ring in case.rings)
    # the unworn operator is the same whether the elements will follow the wear or not
    unworn = Mesh()
    mesh = replace(
        case.mesh, geometry=unworn.geometry, geometry_tolerance=unworn.geometry_tolerance
    )
    return mesh, case.contact, *bodies


def assemble_operator(case: Case, comm: MPI.Comm) -> tuple[Operator, BodyCost]:
    """Assemble and condense both bodies of a case. Collective on comm.

    Raises
    ------
    ComputationError : a factorisation failed.
    """
    bodies = [
        compliance(case.section(ring), case.line, ring.poisson, ring.grip, case.mesh, comm)
        for ring in case.rings
    ]
    return join_bodies(case.line, bodies), BodyCost.of(bodies)


def join_bodies(line: ContactLine, bodies: Sequence[Compliance]) -> Operator:
    """Return the operator of lower and upper. Not collective."""
    return Operator(
        np.array([body.normal for body in bodies]),
        np.array([line.area @ body.torsion for body in bodies]),
        np.array([body.force_reaction for body in bodies]),
        np.array([body.torque_reaction for body in bodies]),
    )


def symmetric(line: ContactLine, normal: FloatArray) -> FloatArray:
    """Return ``sym(diag(m) C)``, mm^3/MPa, of a collocated compliance. Not collective.

    On the first elements at the axis, discs and narrow rings, the areas change from one to the next
    as fast as the elements themselves, and the symmetric part alone is some per cent off on every
    mesh (the pressure at the axis by 3.5 %). There the diagonal takes the difference, such that the
    pressure of a rigid flat face is that of the collocated equations; it varies smoothly but at the
    ends, and so does any other pressure.
    """
    weighted = line.area[:, None] * normal
    stiffness = 0.5 * (weighted + weighted.T)
    if line.edges[0] > 0.0:
        return stiffness
    flat = np.linalg.solve(weighted, line.area)
    lost = 0.5 * ((weighted - weighted.T) @ flat)
    diagonal = weighted.diagonal()
    # elsewhere areas hardly change, and beside corners a flat face's pressure is no guide
    guided = (line.width > _NEAR_AXIS * line.r) & (np.abs(lost) < 0.25 * diagonal * flat)
    correction = np.divide(lost, flat, out=np.zeros_like(flat), where=guided)
    return stiffness + np.diag(correction)


def join(case: Case, operator: Operator) -> ContactPair:
    """Join both bodies of a case with its Young's moduli. Not collective.

    Raises
    ------
    ComputationError : the compliance is not positive definite (the mesh is far too coarse).
    """
    line = case.line
    lower, upper = 1.0 / case.lower.young, 1.0 / case.upper.young
    normal = lower * operator.normal[0] + upper * operator.normal[1]
    weighted = line.area[:, None] * normal
    try:
        stiffness = symmetric(line, normal)
        np.linalg.cholesky(stiffness)
    except np.linalg.LinAlgError as error:
        raise ComputationError(
            f"compliance of {line.n} contact elements: not positive definite; "
            "a finer mesh or a milder grading is needed"
        ) from error
    return ContactPair(
        line,
        stiffness,
        (lower * operator.twist[0] + upper * operator.twist[1]) / line.area.sum(),
        float(np.abs(weighted - weighted.T).max() / np.abs(weighted).max()),
        operator.force_reaction,
        operator.torque_reaction,
    )


def contact_pair(case: Case, comm: MPI.Comm) -> tuple[ContactPair, BodyCost]:
    """Assemble, condense and join both bodies of a case. Collective on comm.

    Raises
    ------
    ComputationError : a factorisation failed, or the compliance is not positive definite.
    """
    operator, cost = assemble_operator(case, comm)
    return join(case, operator), cost


def memory_needed(case: Case, ranks: int) -> float:
    """Return an estimate of the bytes that a run needs on all ranks together.

    The (r, z) system of the larger body (two unknowns a node, two nodes an element) with its
    factor, which every rank holds where there is no ScaLAPACK; the torsion system; the right-hand
    sides; where elements follow the wear, what stays of the matrices of each body that wears; on
    every rank the compliance and its copies, and the responses of whole boundaries where their
    fields are asked for; on one the history.
    """
    n = float(case.mesh.contact_elements)
    unknowns = 4.0 * max(
        count_elements(case.section(r), case.contact, case.mesh) for r in case.rings
    )
    copies = 1.0 if ranks == 1 or has_scalapack() else float(ranks)
    kept = 0.0
    if case.mesh.geometry == "updated":
        kept = 1.25 * sum(law is not None for law in case.laws)
    history, shared = len(case.output.fields) * n * case.stored_rows, 8.0 * n**2
    if case.output.boundary != "none":
        # displacements of two nodes an element and its traction, of both bodies and n loads
        shared += 2.0 * 9.0 * n * unknowns / 4.0
        # what is stored of them; an element has six coordinates, six displacements and more
        rows = 1.0 if case.output.boundary == "last" else case.stored_rows
        history += 2.0 * 15.0 * unknowns / 4.0 * rows
    return 8.0 * ((1.25 + kept + 1.25 * copies) * unknowns**2 + ranks * shared + history)


def check_memory(case: Case, ranks: int, name: str) -> None:
    """Refuse what this machine cannot hold, as if all ranks were on it. Not collective.

    Raises
    ------
    InputError : with the memory needed and the memory there is.
    """
    needed = memory_needed(case, ranks)
    there = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    if needed > 0.9 * there:
        steps = "" if case.time.adaptive else f"time.steps = {case.time.steps}, "
        raise InputError(
            f"{name}: mesh.contact_elements = {case.mesh.contact_elements}, {steps}"
            f"output.every = {case.output.every}: needs about "
            f"{needed / 1e9:.3g} GB of memory, this machine has {there / 1e9:.3g} GB; must be less"
        )


def check_mesh(case: Case, name: str) -> None:
    """Refuse a mesh whose smallest elements drown in round-off. Not collective.

    Raises
    ------
    InputError : with the smallest length.
    """
    for ring in case.rings:
        body = boundary_mesh(case.section(ring), case.line, case.mesh)
        ends = body.nodes[body.elements]
        shortest = float(np.hypot(*(ends[:, 2] - ends[:, 0]).T).min())
        if shortest < 1e-11 * ring.r[1]:
            raise InputError(
                f"{name}: mesh.grading = {case.mesh.grading:g} with mesh.contact_elements = "
                f"{case.mesh.contact_elements}: the shortest element of this geometry is "
                f"{shortest:.1e} mm; must be at least {1e-11 * ring.r[1]:.1e} mm"
            )


def largest_stable_step(pair: ContactPair, slope: FloatArray) -> float:
    """Return the largest stable explicit step, s: 2 / lambda_max(W C^-1), while all is in contact.

    Parameters
    ----------
    slope : (n,) float, mm/s/MPa, derivative of the rate of wear of both bodies together.
    """
    if not slope.any():
        return np.inf
    n = pair.line.n
    weighted = np.diag(pair.line.area * slope)
    largest = eigh(weighted, pair.stiffness, eigvals_only=True, subset_by_index=(n - 1, n - 1))[0]
    return float(2.0 / largest)
