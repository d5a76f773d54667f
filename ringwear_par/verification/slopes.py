"""Sloping faces: matched cones against finite elements, closed forms and fine solutions."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.bem.body import boundary_conditions, solve_body
from ringwear_par.elasticity.bem.boundary import boundary_mesh
from ringwear_par.elasticity.geometry.mesh import ContactLine, Mesh, contact_line
from ringwear_par.elasticity.geometry.sections import Body, Section
from ringwear_par.history.elastic.bodies import bodies, young
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.observers.trace import trace
from ringwear_par.history.start import first_contact
from ringwear_par.verification import reference
from ringwear_par.verification.check import NU, SIZES, Check, checks_of, converging, identity
from ringwear_par.verification.edges import both_wear, rows_against, steady_rows
from ringwear_par.verification.fine import (
    CONTACT,
    SORTS,
    Rings,
    ring_case,
    stored,
)
from ringwear_par.verification.half_space import pressure_at

_CONE = SORTS["cones of 5 degrees"]


def slope_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check matched cones, unworn and worn. Collective on comm."""
    yield converging("torsion of a ring with a conical top of 10 degrees: u_theta",
                     partial(torsion_error, comm=comm), 1e-3)  # fmt: skip
    bathed = [bathed_errors(n, comm) for n in SIZES]
    said = "cones of 5 degrees bathed in their pressure"
    rows = ((f"{said}: approach", 1e-6), (f"{said}: uniform pressure, worst element", 1e-6))
    yield from checks_of(bathed, rows)
    for degrees in reference.CONE_APPROACH:
        yield from _finite_element_rows(degrees, comm)
    for degrees in (5, 10):
        yield from _fine_rows(f"cones of {degrees} degrees", comm)


def cone_errors(
    degrees: float, line: ContactLine, pressure: FloatArray, approach: float
) -> dict[str, float]:
    """Return relative errors against finite elements: ``approach`` and, but for 0 degrees, p(r)."""
    errors = {"approach": abs(approach / reference.CONE_APPROACH[degrees] - 1.0)}
    if degrees in reference.CONE_PRESSURE:
        computed = np.array([pressure_at(line, pressure, r) for r in reference.CONE_RADII])
        errors["p(r)"] = float(np.abs(computed / reference.CONE_PRESSURE[degrees] - 1.0).max())
    return errors


def _finite_element_rows(degrees: float, comm: MPI.Comm) -> Iterator[Check]:
    errors: list[dict[str, float]] = []
    for n in SIZES:
        case = ring_case(Rings(CONTACT, (1e4, 1e5), degrees), Mesh(n))
        first = first_contact(case, comm)
        errors.append(cone_errors(degrees, case.line, first.pressure, first.approach))
    way = {0.0: "flat", 1.0: "rising"}.get(degrees, "falling")
    said = f"matched cones of {abs(degrees):g} degree, {way}" if degrees else "flat flush rings"
    rows = (
        (f"{said}, finite elements: approach", 1e-4, 5e-6),
        (f"{said}, finite elements: p, worst of 5 radii", 2e-3, 2e-4),
    )
    yield from checks_of([list(error.values()) for error in errors], rows[: len(errors[0])])


def _fine_rows(name: str, comm: MPI.Comm) -> Iterator[Check]:
    """Check cones against their fine solution, their torque, held faces, and what is steady."""
    rings, fine = SORTS[name], stored(name)
    cases = [ring_case(rings, Mesh(n)) for n in SIZES]
    pairs = [assemble(case, comm) for case in cases]
    histories = [trace(case, comm, pair=pair) for case, pair in zip(cases, pairs, strict=True)]
    yield from rows_against(name, [fine.on(Mesh(n)) for n in SIZES], histories)
    first, physics = histories[-1].states[0].contact, histories[-1].physics
    n, line = physics.line.n, physics.line
    flat = physics.case.friction_at(0.0) * (line.area * line.arm) @ first.pressure
    error = abs(
        physics.torque(first.pressure)[0] / flat * math.cos(math.radians(rings.degrees)) - 1.0
    )
    yield identity(f"{name}: torque, 1 / cos alpha of a flat face's", n,
                   float(error), 1e-12)  # fmt: skip
    balances = [(h.balances.reaction, h.balances.torque) for h in histories]
    rows = [(f"{name}: {text} on the held faces, all steps", 1e-4) for text in ("force", "torque")]
    yield from checks_of(balances, rows, kind="identity")
    yield from steady_rows(name, rings, pairs, comm)
    yield from both_wear(name, rings, pairs[1], comm)


def bathed_errors(n: int, comm: MPI.Comm) -> tuple[float, float]:
    """Return the errors of cones of 5 degrees all of whose free faces bear 1 MPa, as the contact.

    The force is that of 1 MPa in the contact; fixed faces leave u_r free. Of the approach, and of
    the worst pressure. The symmetric compliance is made for pressures that are singular at these
    edges, as those of faces of this shape are: of this one, which is not, it alone misses the
    outermost elements by tens of per cent, and all depends on its correction.
    """
    case = ring_case(_CONE, Mesh(n))
    case = replace(case, lower=replace(case.lower, grip="platen"),
                   upper=replace(case.upper, grip="platen"))  # fmt: skip
    pair = assemble(case, comm)
    both, moduli, line = bodies(case), young(case), pair.line
    sides = zip(both, moduli, (pair.slope, -pair.slope), strict=True)
    deflection = sum((_bath(body, case, t, comm) / e for body, e, t in sides), np.zeros(n))
    compliance, approach, p = pair.compliance(moduli), 0.0, np.zeros(n)
    for _ in range(6):  # deferred correction, as a history does
        gap = deflection - compliance.excess @ p
        right = np.stack([line.area, line.area * gap], axis=1)
        unit, bath = np.linalg.solve(compliance.matrix, right).T
        approach = float(line.area @ (1.0 + bath) / (line.area @ unit))
        p = approach * unit - bath
    rise = math.tan(math.radians(_CONE.degrees)) * CONTACT[0]
    apexes = (
        body.section.height + float(body.section.points[0, 1]) - side * rise
        for body, side in zip(both, (1.0, -1.0), strict=True)
    )
    exact = reference.bathed_approach(apexes, moduli, NU, 1.0)
    return abs(approach / exact - 1.0), float(np.abs(p - 1.0).max())


def _bath(body: Body, case: Case, slope: FloatArray, comm: MPI.Comm) -> FloatArray:
    """Return the deflection of a contact face, mm at E = 1, under 1 MPa on the sides of a body."""
    line, mesh = case.line, case.mesh
    boundary = boundary_mesh(body.section, line, mesh)
    loaded = boundary_conditions(boundary, body.grip, slope)
    load, traction = np.full_like(loaded.load, -1), np.zeros_like(loaded.traction)
    for side, value in ((boundary.inner_side, 1.0), (boundary.outer_side, -1.0)):
        load[side, 0], traction[side, 0] = 0, value
    middle = boundary.elements[boundary.contact, 1]
    response = solve_body(
        boundary, loaded._replace(load=load, traction=traction, n_loads=1), body.poisson,
        mesh.quadrature_tolerance, middle, boundary.contact, comm,
    )  # fmt: skip
    radial, axial = response.displacement[:, 0, 0], response.displacement[:, 1, 0]
    return slope * radial - axial


def torsion_error(n: int, comm: MPI.Comm) -> float:
    """Return the error of u_theta = twist r (z + h) on a conical top of a hollow cylinder.

    Its traction per true area is shear x twist x r cos alpha.
    """
    alpha, (a, b), height = math.radians(10.0), (20.0, 40.0), 20.0
    section = Section((a, b), height, ((a, -(b - a) * math.tan(alpha)), (b, 0.0)))
    mesh = Mesh(n)
    line = contact_line((a, b), mesh)
    boundary = boundary_mesh(section, line, mesh)
    conditions = boundary_conditions(boundary, "clamped", np.full(n, math.tan(alpha)))
    middle = boundary.elements[boundary.contact, 1]
    response = solve_body(boundary, conditions, NU, 1e-8, middle, boundary.contact, comm)
    r, z = boundary.nodes[middle].T
    shear = 0.5 / (1.0 + NU)
    u = response.displacement[:, 2] @ (shear * r * math.cos(alpha))
    return float(np.abs(u / (r * (z + height)) - 1.0).max())
