"""``ringwear verify``: ten checks that this installation computes rightly. Units: mm, N, MPa, s.

They run what a wear history runs: the element integrals, PETSc's factorisations, the contact
solver, fixed layers and adaptive time steps, each against a closed form, an independent finite
element solution or a balance. The tests in ``tests/verification`` compare far more.
"""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Load, Output, Ring, RingLayer, Stepping
from ringwear_par.cases.law import Law
from ringwear_par.elasticity.bem.body import compliance, solve_zones
from ringwear_par.elasticity.bem.boundary import zone_meshes
from ringwear_par.elasticity.bem.systems import BoundaryConditions, Zone
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Material, Section
from ringwear_par.errors import ComputationError
from ringwear_par.history.elastic import assemble
from ringwear_par.history.loop import first_contact
from ringwear_par.parallel import together
from ringwear_par.results.run import simulate

#: Poisson's ratio of all bodies
NU = 0.3
#: the paper's rings, unworn, 50 MPa (28274.334 N), top clamped: an independent finite element
#: solution; the approach also with a bonded layer of 100 GPa, 0.05 mm thick, on the lower one
APPROACH, PRESSURE_AT_30, COATED_APPROACH = 0.0365486, 34.392, 0.0360214
#: contact elements of the paper's rings: of an odd number one has its middle at r = 30 mm
RINGS = Mesh(65)
#: specific wear rate, 1/MPa, and threshold, MPa, of the lower ring
K, P0 = 1e-7, 40.0


@dataclass(frozen=True)
class Check:
    """Numbers and what they must be, within a relative difference."""

    name: str
    computed: float | FloatArray
    reference: float | FloatArray
    limit: float

    @property
    def worst(self) -> tuple[float, float, float]:
        """Computed number, reference and relative difference where that is largest, or NaN."""
        computed, reference = np.broadcast_arrays(self.computed, self.reference)
        differences = np.abs(computed / reference - 1.0)
        at = differences.argmax()
        return float(computed.flat[at]), float(reference.flat[at]), float(differences.flat[at])

    @property
    def passed(self) -> bool:
        """Whether all differences are within the limit (not so for NaN)."""
        return self.worst[2] <= self.limit


def body_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check a hollow cylinder, E = 1 MPa, under loads whose fields are simple. Collective."""
    radii, height, mesh, shear = (20.0, 40.0), 20.0, Mesh(32), 0.5 / (1.0 + NU)
    section, line = Section(radii, height), contact_line(radii, mesh)
    body = compliance(Body(section, 1.0, NU, "platen"), line, mesh, comm)
    yield Check("bar under pressure: u_z of its top (mm)", body.normal.sum(axis=1), height, 1e-5)
    inner, outer, (a, b) = 3.0, 1.0, radii
    bore = _pressed_sides(section, (inner, outer), mesh, comm)
    uniform, decaying = inner * a * a - outer * b * b, (inner - outer) * a * a * b * b
    exact = (1.0 + NU) * ((1.0 - 2.0 * NU) * uniform * a + decaying / a) / (b * b - a * a)
    yield Check("Lame, plane strain: u_r of the bore (mm)", bore, exact, 1e-5)
    turned = body.torsion @ (shear * line.r)
    yield Check("torsion: u_theta of the top (mm)", turned, line.r * height, 1e-3)


def _pressed_sides(
    section: Section, pressures: tuple[float, float], mesh: Mesh, comm: MPI.Comm
) -> FloatArray:
    """Return u_r of the bore between two smooth planes, under pressures inside and outside."""
    boundary = zone_meshes(section, contact_line(section.r, mesh), mesh)[0]
    k = len(boundary.elements)
    fixed, load, traction = np.zeros((k, 3), dtype=bool), np.full((k, 3), -1), np.zeros((k, 3))
    fixed[np.concatenate([boundary.fixed, boundary.contact]), 1] = True
    fixed[boundary.fixed, 2] = True
    for side, value in ((boundary.inner_side, pressures[0]), (boundary.outer_side, -pressures[1])):
        load[side, 0], traction[side, 0] = 0, value
    conditions = BoundaryConditions(fixed, load, traction, 1)
    (response,), _ = solve_zones([Zone(boundary, conditions, Material(1.0, NU))], 1e-8, comm)
    bore: FloatArray = response.displacement[boundary.elements[boundary.inner_side, 1], 0, 0]
    return bore


def sphere_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check a rigid sphere on a half-space, E = 1 MPa, with contact radius 1 mm. Collective.

    Discs stand in for it; what they add to the compliance is proportional to 1 / their radius.
    """
    radius, approach, modulus = 10.0, 0.1, 1.0 / (1.0 - NU * NU)
    r = np.linspace(0.0, 1.6, 401)
    face = tuple((float(x), -float(x * x / (2.0 * radius))) for x in r)
    forces, peaks = [], []
    for size in (50.0, 100.0):
        case = Case(
            Ring((0.0, size), (0.0, size), 1.0, NU, "clamped"),
            Ring((0.0, 1.6), (size, size + 2.0), 1e13, NU, "clamped", face),
            0.1, None, None, Load(0.0, displacement=approach), Stepping("implicit", 1.0, 1),
            Mesh(64, grading=1.0), Output(),
        )  # fmt: skip
        contact, inside = first_contact(case, comm), case.line.r < 0.5
        forces.append(contact.pressure[0] @ case.line.area)
        squares = np.polyfit(case.line.r[inside] ** 2, contact.pressure[0, inside] ** 2, 1)
        peaks.append(math.sqrt(squares[1]))  # p^2 is linear in r^2
    computed = 2.0 * np.array([forces[1], peaks[1]]) - np.array([forces[0], peaks[0]])
    force = 4.0 / 3.0 * modulus * math.sqrt(radius) * approach**1.5
    exact = np.array([force, 1.5 * force / math.pi])
    yield Check("Hertz: force (N), largest pressure (MPa)", computed, exact, 2e-4)


def _rings(pressure: float, p0: float, until: float, layers: tuple[RingLayer, ...] = ()) -> Case:
    """Return the paper's rings under a mean pressure, the lower one wearing."""
    law = Law.of_values("threshold", k=K, p0=p0)
    case = Case(
        Ring((20.0, 40.0), (0.0, 20.0), 10e3, NU, "clamped", layers=layers),
        Ring((28.5, 31.5), (20.0, 40.0), 100e3, NU, "clamped"),
        0.1, law, None, Load(85.0 / 24.0, 1.0), Stepping("adaptive", until=until),
        RINGS, Output(),
    )  # fmt: skip
    return replace(case, load=replace(case.load, force=pressure * case.area))


def ring_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check the paper's rings, unworn, coated and worn. Collective on comm."""
    case = _rings(50.0, 0.0, 20.0)
    pair = assemble(case, comm)
    result = simulate(case, comm, pair=pair)
    approach, pressure = result.histories["approach"], result.profiles["pressure"]
    yield Check("paper's rings, finite elements: approach (mm)", approach[0], APPROACH, 5e-5)
    middle = pressure[0, len(pressure[0]) // 2]
    yield Check("paper's rings, finite elements: p(30 mm) (MPa)", middle, PRESSURE_AT_30, 3e-4)
    coated = first_contact(_rings(50.0, 0.0, 1.0, (RingLayer(0.05, 100e3, NU),)), comm)
    yield Check("hard coating, finite elements: approach (mm)", coated.approach,
                COATED_APPROACH, 5e-5)  # fmt: skip
    volume, energy = (result.histories[f][1:] for f in ("worn_volume_lower", "dissipated_energy"))
    yield Check("worn volume = k x energy (mm3)", volume, K * energy, 1e-10)

    case = _rings(80.0, P0, 200.0)
    worn = simulate(case, comm, pair=pair).profiles["wear_lower"][-1]
    exact = replace(case, time=Stepping("adaptive", until=200.0, tolerance=1e-7))
    fine = simulate(exact, comm, pair=pair).profiles["wear_lower"][-1]
    yield Check("adaptive steps: wear after 200 s (mm)", worn, fine, 2e-3)
    long = simulate(_rings(80.0, P0, 8000.0), comm, pair=pair)
    a, b = case.contact
    c = (80.0 - P0) * case.area / (2.0 * math.pi * (b - a))
    steady = P0 + c / long.line.r
    yield Check("steady pressure p0 + c / r (MPa)", long.profiles["pressure"][-1], steady, 1e-5)


#: what runs, in the order in which it is printed
CHECKS = (body_checks, sphere_checks, ring_checks)


def verify(comm: MPI.Comm) -> None:
    """Print every check as it is done; ComputationError names failed ones. Collective on comm."""
    started, count, failed = time.perf_counter(), 0, []

    def say(*words: str) -> None:
        if comm.rank == 0:
            print("{:46} {:>11} {:>11} {:>10} {:>6} {:>6}".format(*words), flush=True)

    say("check", "computed", "reference", "difference", "limit", "")
    for check in (check for checks in CHECKS for check in checks(comm)):
        computed, reference, difference = check.worst
        say(check.name, f"{computed:.7g}", f"{reference:.7g}", f"{difference:.1e}",
            f"{check.limit:.0e}", "ok" if check.passed else "failed")  # fmt: skip
        count += 1
        if not check.passed:
            failed.append(check.name)
    passed = f"{count - len(failed)} of {count} checks passed"
    if comm.rank == 0:
        print(f"{passed} in {time.perf_counter() - started:.1f} s", flush=True)
    with together(comm):
        if failed:
            raise ComputationError(f"{passed}; failed: {'; '.join(failed)}")
