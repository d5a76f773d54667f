"""Bodies with bonded layers against exact solutions, coated rings of the paper, thin discs.

Half-spaces are stood in for as in ``half_space``, by larger discs: where a layer is stiff, what the
truncation adds falls off more slowly.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from scipy.special import j0, j1, jn_zeros

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.body import (
    BoundaryProblem,
    body_zones,
    contact_problem,
    solve_bodies,
)
from ringwear_par.elasticity.bem.boundary import boundary_mesh
from ringwear_par.elasticity.bem.pair import assemble_pair
from ringwear_par.elasticity.bem.systems import BoundaryConditions, Zone
from ringwear_par.elasticity.mesh import ContactLine, Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Material, Section
from ringwear_par.history.elastic.bodies import bodies
from ringwear_par.verification import reference
from ringwear_par.verification.check import NU, SIZES, Check, checks_of
from ringwear_par.verification.half_space import GRADED, pressure_at, without_truncation
from ringwear_par.verification.histories import paper_case
from ringwear_par.verification.reference import LayeredHalfSpace

#: numbers of elements where solutions are expensive, or where 128 show only the quadrature
_COARSE = 16, 32, 64
_HALF_SPACE = Material(1.0, NU)
#: layers on it
_HARD, _SOFT = Material(10.0, 0.2), Material(0.1, 0.4)
#: radii of the discs that stand for a half-space
_DISCS = 200.0, 400.0
#: tolerance of the element integrals
_TOLERANCE = 1e-8


def layer_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check bodies with layers, alone and in contact. Collective on comm."""
    yield from patch_checks(comm)
    yield from mode_checks(comm)
    for thickness in (0.5, 0.05):
        for name, layer in (("hard", _HARD), ("soft", _SOFT)):
            yield from _half_space_rows(f"{name} layer {thickness:g}", thickness, layer, comm)
    yield from coating_checks(comm)
    yield from thin_disc_checks(comm)


def bar_errors(n: int, comm: MPI.Comm) -> tuple[float, float]:
    """Return the errors of a bar of two materials with one nu / E under uniform pressure.

    Of u_z on its top, and of the tractions of the interface, over the pressure.
    """
    h, layer, base = 4.0, Material(2.0, 0.4), Material(1.0, 0.2)
    section, mesh = Section((20.0, 40.0), 20.0, (), (h,)), Mesh(n)
    line = contact_line(section.r, mesh)
    body = Body(section, base.young, base.poisson, "platen", (layer,))
    problem = contact_problem(body, line, mesh, None, None)
    bonded = problem.zones[1].boundary.above
    problem = replace(problem, elements=(np.array([], dtype=int), bonded))
    response = solve_bodies([problem], comm)[0]
    exact = h / layer.young + (section.height - h) / base.young
    u, t = -response.displacement[:, 1].sum(axis=1), response.traction[:, :2].sum(axis=2)
    return float(np.abs(u / exact - 1.0).max()), float(np.abs(t - [0.0, -1.0]).max())


def sleeve_errors(n: int, comm: MPI.Comm) -> tuple[float, float]:
    """Return the errors of two bonded concentric rings between smooth planes, under pressure.

    Of u_r on the bore, and of the pressure between them.
    """
    radii, pressures, height = (20.0, 30.0, 40.0), (3.0, 1.0), 10.0
    materials = Material(0.5, 0.4), Material(1.0, 0.25)
    zones: list[Zone] = []
    for r, material in zip((radii[:2], radii[1:]), materials, strict=True):
        boundary = boundary_mesh(Section(r, height), contact_line(r, Mesh(n)), Mesh(n))
        k, none = len(boundary.elements), np.array([], dtype=int)
        fixed = np.zeros((k, 3), dtype=bool)
        fixed[np.concatenate([boundary.fixed, boundary.contact]), 1] = True
        fixed[boundary.fixed, 2] = True
        load, traction = np.full((k, 3), -1), np.zeros((k, 3))
        if zones:  # interfaces go upwards
            pressed, value = boundary.outer_side, -pressures[1]
            boundary = boundary._replace(above=boundary.inner_side[::-1].copy(), inner_side=none)
        else:
            pressed, value = boundary.inner_side, pressures[0]
            boundary = boundary._replace(below=boundary.outer_side, outer_side=none)
        load[pressed, 0], traction[pressed, 0] = 0, value
        zones.append(Zone(boundary, BoundaryConditions(fixed, load, traction, 1), material))
    first, second = (zone.boundary for zone in zones)
    problem = BoundaryProblem(
        tuple(zones), _TOLERANCE, (first.elements[first.inner_side, 1], none),
        (none, second.above),
    )  # fmt: skip
    response = solve_bodies([problem], comm)[0]
    between = reference.sleeve_pressure(radii, *pressures, materials)
    bore = reference.lame_displacement(
        np.array(radii[0]), *radii[:2], pressures[0], between, materials[0].young,
        materials[0].poisson,
    )  # fmt: skip
    u, t = response.displacement[:, 0, 0], response.traction[:, 0, 0]
    return float(np.abs(u / bore - 1.0).max()), float(np.abs(t / between - 1.0).max())


def patch_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check fields that are uniform in each material, or nearly so. Collective on comm."""
    for name, values, errors in (
        ("bar of two materials", ("u_z", "interface"), [bar_errors(n, comm) for n in _COARSE]),
        ("Lame, bonded sleeve", ("u_r of the bore", "pressure between"),
         [sleeve_errors(n, comm) for n in _COARSE]),
    ):  # fmt: skip
        yield from checks_of(errors, [(f"{name}: {value}", 1e-6) for value in values], _COARSE)


def mode_errors(n: int, comm: MPI.Comm) -> tuple[float, float, float, float]:
    """Return the errors of a disc with two layers under Bessel modes, root mean square.

    Of the displacement of its face, over its amplitude, and of the tractions of its interfaces,
    over the amplitude of the load, under pressure J0(k r) between smooth sides and under shear
    J1(k r) with free ones, its base being clamped.
    """
    big_r, base = 10.0, Material(1.0, NU)
    stack = [(0.5, Material(5.0, 0.2)), (1.0, Material(0.5, 0.45)), (6.5, base)]
    thicknesses, materials = zip(*stack, strict=True)
    section = Section((0.0, big_r), sum(thicknesses), (), thicknesses[:-1])
    mesh = Mesh(n)
    line = contact_line(section.r, mesh)
    body = Body(section, base.young, base.poisson, "clamped", materials[:-1])
    squeezed, turned = (float(jn_zeros(order, 2)[1]) / big_r for order in (1, 2))
    zones = []
    for zone in body_zones(body, line, mesh):
        boundary, (fixed, load, traction, _) = zone.boundary, zone.conditions
        fixed[boundary.outer_side, 0] = True
        load[boundary.contact] = 0
        if len(boundary.contact):
            traction[boundary.contact, 1] = -j0(squeezed * line.r)
            traction[boundary.contact, 2] = j1(turned * line.r)
        conditions = BoundaryConditions(fixed, load, traction, 1)
        zones.append(replace(zone, conditions=conditions))
    problem = BoundaryProblem(
        tuple(zones), _TOLERANCE,
        tuple(zone.boundary.elements[zone.boundary.contact, 1] for zone in zones),
        tuple(zone.boundary.above for zone in zones),
    )  # fmt: skip
    response = solve_bodies([problem], comm)[0]
    odd, even, angular = j1(squeezed * line.r), j0(squeezed * line.r), j1(turned * line.r)
    pattern = np.stack([odd, even], axis=1)
    normal = reference.normal_mode(squeezed, stack)[:-1, None].reshape(-1, 2, 1, 2)
    torsion = reference.torsion_mode(turned, stack)[:-1]
    u = response.displacement[:, :, 0]
    t = response.traction[:, :, 0].reshape(-1, n, 3)  # interfaces have the elements of the face
    return (
        _root_mean_square(u[:, :2] - normal[0, 0] * pattern, line) / np.abs(normal[0, 0]).max(),
        _root_mean_square(t[:, :, :2] - normal[1:, 1] * pattern, line),
        _root_mean_square(u[:, 2:] - torsion[0, 0] * angular[:, None], line) / torsion[0, 0],
        _root_mean_square(t[:, :, 2:] - np.multiply.outer(torsion[1:, 1], angular)[..., None],
                          line),
    )  # fmt: skip


def _root_mean_square(error: FloatArray, line: ContactLine) -> float:
    """Return the largest of the root mean squares of errors (..., n, components) over the area."""
    return float(np.sqrt((line.area @ error**2 / line.area.sum()).max()))


def mode_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check a finite disc with two layers under Bessel modes. Collective on comm."""
    errors = [mode_errors(n, comm) for n in SIZES]
    texts = (
        "pressure J0: u of the face", "pressure J0: interfaces", "shear J1: u of the face",
        "shear J1: interfaces",
    )  # fmt: skip
    yield from checks_of(errors, [(f"disc with two layers, {text}", 1e-3) for text in texts])


@dataclass(frozen=True)
class _Loaded:
    """A layered disc loaded on the circle r < 1, at the modulus of what is under the layer."""

    axis: float  # u_z downwards under pressure 1: on the axis,
    inside: FloatArray  # at the elements,
    rim: float  # and at the end of the load
    force: float  # of a rigid flat punch per approach
    pressure: FloatArray  # under it, over the mean


def _loaded(disc: Body, line: ContactLine, mesh: Mesh, comm: MPI.Comm) -> _Loaded:
    problem = contact_problem(disc, line, mesh, None, None)
    contact = problem.zones[0].boundary.elements[problem.zones[0].boundary.contact]
    nodes = np.array([*contact[:, 1], contact[0, 2], contact[-1, 0]])
    problem = replace(problem, nodes=(nodes, problem.nodes[1]))
    compliance = -solve_bodies([problem], comm)[0].displacement[:, 1]
    *inside, axis, rim = compliance.sum(axis=1)
    p = np.linalg.solve(compliance[: line.n], np.ones(line.n))
    force = float(line.area @ p)
    return _Loaded(axis, np.array(inside), rim, force, p * line.area.sum() / force)


def _half_space_rows(
    name: str, thickness: float, layer: Material, comm: MPI.Comm
) -> Iterator[Check]:
    exact = LayeredHalfSpace(thickness, layer, _HALF_SPACE)
    errors = []
    for n in _COARSE:
        mesh = Mesh(n, grading=GRADED)
        line = contact_line((0.0, 1.0), mesh)
        near, far = (
            _loaded(Body(Section((0.0, big_r), big_r, (), (thickness,)), _HALF_SPACE.young,
                         _HALF_SPACE.poisson, "clamped", (layer,)), line, mesh, comm)
            for big_r in _DISCS
        )  # fmt: skip
        inner = line.r < 0.9
        axis, *inside, rim = exact.bathed_circle(np.array([0.0, *line.r, 1.0]))
        force, share = exact.punch(line.edges)
        pressure = np.diff(share) * line.area.sum() / line.area
        errors.append(
            (
                abs((2.0 * far.axis - near.axis) / axis - 1.0),
                float(np.abs((2.0 * far.inside - near.inside) / inside - 1.0)[inner].max()),
                abs((2.0 * far.rim - near.rim) / rim - 1.0),
                abs(without_truncation((near.force, far.force)) / force - 1.0),
                float(np.abs(far.pressure - pressure)[inner].max()),
            )
        )
    rows = (
        (f"{name}, uniform pressure: u_z on the axis", 2e-4),
        (f"{name}, uniform pressure: u_z, worst to 0.9 a", 5e-4),
        (f"{name}, uniform pressure: u_z at the edge", 1e-3),
        (f"{name}, rigid flat punch: force", 5e-4),
        (f"{name}, rigid flat punch: p / p(mean), worst to 0.9 a", 5e-3),
    )
    yield from checks_of(errors, rows, _COARSE)


@dataclass(frozen=True)
class _Coated:
    """The paper's rings with layers, in full contact without wear, at 50 MPa."""

    line: ContactLine
    approach: float
    pressure: FloatArray
    on_fixed: tuple[float, float]  # largest errors of force and torque on the held faces


def paper_rings(
    lower: Sequence[tuple[float, Material]] = (), upper: Sequence[tuple[float, Material]] = ()
) -> tuple[Body, Body]:
    """Return the paper's rings with layers, each a thickness (mm) and a material."""

    def layered(body: Body, layers: Sequence[tuple[float, Material]]) -> Body:
        section = replace(body.section, layers=tuple(thickness for thickness, _ in layers))
        return replace(body, section=section, layers=tuple(material for _, material in layers))

    below, above = bodies(paper_case(Mesh()))
    return layered(below, lower), layered(above, upper)


def _coated(coated: tuple[Body, Body], n: int, comm: MPI.Comm) -> _Coated:
    case = paper_case(Mesh(n), pressure=50.0)
    line, force = case.line, case.area * 50.0
    young_moduli = (coated[0].young, coated[1].young)
    pair = assemble_pair(coated, line, case.mesh, comm).compliance(young_moduli)
    unit = np.linalg.solve(pair.matrix, line.area)
    approach = force / float(line.area @ unit)
    p = approach * unit
    torque = (line.area * line.arm) @ p
    return _Coated(
        line, approach, p,
        (float(np.abs(pair.force_reaction @ p / force - 1.0).max()),
         float(np.abs(pair.torque_reaction @ p / torque - 1.0).max())),
    )  # fmt: skip


def coating_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check coated rings of the paper. Collective on comm."""
    case = paper_case(Mesh())
    base, plain = Material(case.lower.young, NU), {}
    for n in _COARSE:
        plain[n] = _coated(paper_rings(), n, comm).approach
    for label, rings in (
        *((f"{h:g} mm below", paper_rings([(h, base)])) for h in (0.005, 0.05, 0.5)),
        ("0.05 mm above", paper_rings([], [(0.05, Material(case.upper.young, NU))])),
    ):
        errors = tuple(abs(_coated(rings, n, comm).approach / plain[n] - 1.0) for n in _COARSE)
        yield Check(f"paper, {label} of the same material: approach", _COARSE, errors, 1e-5)
    hard = paper_rings([(0.05, Material(100e3, NU))])
    solutions = [_coated(hard, n, comm) for n in SIZES]
    exact = reference.COATED_APPROACH
    approaches = tuple(abs(solution.approach / exact - 1.0) for solution in solutions)
    yield Check("paper, hard coating: approach", SIZES, approaches, 1e-5, 1.4e-6)
    for r, exact in reference.COATED_PRESSURE.items():
        errors = tuple(abs(pressure_at(solution.line, solution.pressure, r) / exact - 1.0)
                       for solution in solutions)  # fmt: skip
        yield Check(f"paper, hard coating: p({r:g})", SIZES, errors,
                    *((3e-4, 1.5e-5) if r == 30.0 else (2e-3, 1e-5)))  # fmt: skip
    rows = [
        (f"paper, hard coating: {text} on the held faces", 1e-4) for text in ("force", "torque")
    ]
    yield from checks_of([solution.on_fixed for solution in solutions], rows, kind="identity")


#: thin soft discs under a stiff ring: height (mm) and Poisson's ratio, and the ring's radii
_THIN, _NARROWER = ((2.0, 0.4), (1.5, 0.499)), (10.0, 20.0)
#: elements of the solution that the others are compared with
_FINE = 128


def thin_disc_errors(
    height: float, poisson: float, sizes: Sequence[int], comm: MPI.Comm
) -> list[tuple[float, float]]:
    """Return the errors of thin discs, clamped and wider than the ring that presses on them.

    Of the approach, and of the pressure 0.7 mm inside both edges and in the middle, for some
    numbers of contact elements. The reference is the same disc as a layer on a rigid body, which
    has no elements of a held face near.
    """
    soft, rigid, base = Material(500.0, poisson), Material(1e12, NU), 20.0
    disc = Body(Section((0.0, 30.0), height), soft.young, soft.poisson, "clamped")
    layer = Body(
        Section((0.0, 30.0), base + height, (), (height,)), rigid.young, rigid.poisson, "clamped",
        (soft,),
    )  # fmt: skip
    ring = Body(Section(_NARROWER, 10.0), 200e3, NU, "clamped")
    radii = (_NARROWER[0] + 0.7, 0.5 * sum(_NARROWER), _NARROWER[1] - 0.7)

    def solution(lower: Body, n: int) -> FloatArray:
        mesh = Mesh(n)
        line = contact_line(_NARROWER, mesh)
        pair = assemble_pair((lower, ring), line, mesh, comm)
        unit = np.linalg.solve(pair.compliance((lower.young, ring.young)).collocated, np.ones(n))
        approach = 1.0 / float(line.area @ unit)
        return np.array([approach, *(pressure_at(line, approach * unit, r) for r in radii)])

    exact = solution(layer, _FINE)
    every = [np.abs(solution(disc, n) / exact - 1.0) for n in sizes]
    return [(float(errors[0]), float(errors[1:].max())) for errors in every]


def thin_disc_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check thin soft discs on their held faces. Collective on comm."""
    sizes = 32, 64
    for height, poisson in _THIN:
        errors = thin_disc_errors(height, poisson, sizes, comm)
        label = f"soft disc of {height:g} mm, nu {poisson:g}, under a narrower ring"
        rows = (
            (f"{label}: approach", 3e-4, 4e-5),
            (f"{label}: p 0.7 mm inside edges, p(mid)", 1e-3, 1e-4),
        )
        yield from checks_of(errors, rows, sizes)
