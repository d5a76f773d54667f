"""Two bodies in contact: everything that a wear history needs to know of their elasticity."""

import os
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.linalg import eigh

from ringwear_par.body import Compliance, compliance
from ringwear_par.case import Case
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.geometry import ContactLine, FloatArray, contact_line, count_elements


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
    force_defect, torque_defect : largest relative difference, over both bodies and all contact
        elements, of the reaction on the held face from the load; vanish with the mesh.
    """

    line: ContactLine
    stiffness: FloatArray
    twist: FloatArray
    symmetry_defect: float
    force_defect: float
    torque_defect: float


@dataclass(frozen=True)
class BodyCost:
    """What the boundary elements of both bodies took (wall seconds on this rank)."""

    kernel_evaluations: int
    seconds_assembly: float
    seconds_solution: float


def join(
    line: ContactLine, lower: Compliance, upper: Compliance, young: tuple[float, float]
) -> ContactPair:
    """Join two bodies with Young's moduli ``young`` (MPa). Not collective.

    Raises
    ------
    ComputationError : the compliance is not positive definite (the mesh is far too coarse).
    """
    m, bodies = line.area, (lower, upper)
    weighted = m[:, None] * sum(
        (body.normal / e for body, e in zip(bodies, young, strict=True)), np.zeros((line.n, line.n))
    )
    stiffness = 0.5 * (weighted + weighted.T)
    try:
        np.linalg.cholesky(stiffness)
    except np.linalg.LinAlgError as error:
        raise ComputationError(
            f"compliance of {line.n} contact elements: not positive definite; "
            "a finer mesh or a milder grading is needed"
        ) from error
    twist = sum(
        (m @ body.torsion / e for body, e in zip(bodies, young, strict=True)), np.zeros(line.n)
    )
    return ContactPair(
        line,
        stiffness,
        twist / m.sum(),
        float(np.abs(weighted - weighted.T).max() / np.abs(weighted).max()),
        max(float(np.abs(body.force_reaction / m - 1.0).max()) for body in bodies),
        max(float(np.abs(body.torque_reaction / (m * line.arm) - 1.0).max()) for body in bodies),
    )


def contact_pair(case: Case, comm: MPI.Comm) -> tuple[ContactPair, BodyCost]:
    """Assemble and condense both bodies of a case. Collective on comm."""
    bodies = [
        compliance(case.section(ring), ring.poisson, ring.grip, case.mesh, comm)
        for ring in (case.lower, case.upper)
    ]
    cost = BodyCost(
        sum(body.response.kernel_evaluations for body in bodies),
        sum(body.response.seconds_assembly for body in bodies),
        sum(body.response.seconds_solution for body in bodies),
    )
    line = contact_line(case.contact, case.mesh)
    return join(line, bodies[0], bodies[1], (case.lower.young, case.upper.young)), cost


def memory_needed(case: Case, ranks: int) -> float:
    """Return an estimate of the bytes that the boundary elements need on all ranks together.

    The (r, z) system of the larger body (two unknowns a node, two nodes an element) with its
    factor, the torsion system with its own, the right-hand sides, and on every rank the compliance
    and its copies.
    """
    n = float(case.mesh.contact_elements)
    unknowns = 4.0 * max(
        count_elements(case.section(r), case.mesh) for r in (case.lower, case.upper)
    )
    return 8.0 * (2.5 * unknowns**2 + 4.0 * unknowns * n + ranks * 8.0 * n**2)


def check_memory(case: Case, ranks: int, name: str) -> None:
    """Refuse a mesh that this machine cannot hold. Not collective.

    Raises
    ------
    InputError : with the memory needed and the memory there is.
    """
    needed = memory_needed(case, ranks)
    there = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    if needed > 0.9 * there:
        allowed = int(case.mesh.contact_elements * (0.9 * there / needed) ** 0.5)
        raise InputError(
            f"{name}: mesh.contact_elements = {case.mesh.contact_elements}: needs "
            f"{needed / 1e9:.3g} GB of memory, this machine has {there / 1e9:.3g} GB; "
            f"must be at most about {allowed}"
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
