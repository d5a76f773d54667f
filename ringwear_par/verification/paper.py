"""The paper's rings: their contact against independent solutions, and by each method of TAO."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from ringwear_par.cases.case import Case, Load, Output, Ring, Stepping
from ringwear_par.contact.engine import TAO_TYPES, ContactEngine
from ringwear_par.contact.problem import ContactState
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.geometry.mesh import Mesh
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.physics import Physics
from ringwear_par.history.start import first_contact
from ringwear_par.verification import reference
from ringwear_par.verification.check import NU, Check, checks_of
from ringwear_par.verification.half_space import pressure_at
from ringwear_par.wear.laws.threshold import ThresholdLaw

#: our reading of the paper's speed, rad/s
OMEGA = 85.0 / 24.0
_PAPER_STEPPING = Stepping("implicit", 1.0, 200)
#: of contacts that all methods of TAO solve: elements, s of wear in the step, heights (mm) of
#: roughness
_ELEMENTS, _WEAR_STEP, _HEIGHTS = 64, 20.0, (0.0, 0.01, 0.05)


def paper_case(
    mesh: Mesh, pressure: float = 80.0, p0: tuple[float | None, float | None] = (40.0, None),
    stepping: Stepping = _PAPER_STEPPING, young: float = 100e3,
    k: tuple[float, float] = (1e-7, 1e-7),
) -> Case:  # fmt: skip
    """Return the paper's rings (load and speed are our reading), p0 of lower and upper in MPa."""
    laws = [ThresholdLaw(ki, pi) if pi is not None else None for ki, pi in zip(k, p0, strict=True)]
    case = Case(
        Ring((20.0, 40.0), (0.0, 20.0), 10e3, NU, "clamped"),
        Ring((28.5, 31.5), (20.0, 40.0), young, NU, "clamped"),
        0.1, laws[0], laws[1], Load(OMEGA, 1.0), stepping, mesh, Output(),
    )  # fmt: skip
    return replace(case, load=Load(OMEGA, pressure * case.area))


def paper_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare the unworn paper case with an independent finite element solution."""
    sizes, pressures = (32, 64, 128, 256), reference.PAPER_PRESSURE
    values: list[list[float]] = []
    for n in sizes:
        case = paper_case(Mesh(n), pressure=50.0)
        contact, line = first_contact(case, comm), case.line
        p, mu = contact.pressure, case.friction_at(0.0)
        values.append(
            [contact.approach / reference.PAPER_APPROACH - 1.0,
             mu * (line.area * line.arm) @ p / reference.PAPER_TORQUE - 1.0]
            + [pressure_at(line, p, r) / v - 1.0 for r, v in pressures.items()]
        )  # fmt: skip
    names = ["approach", "torque", *(f"p({r:g})" for r in pressures)]
    allowed = ((1e-5, 1.4e-6), (1e-4, 6e-7), (1e-3, 1.5e-5), (1e-3, 6e-6), (1e-3, 6e-6))
    rows = [(f"paper, 50 MPa: {name}", *of) for name, of in zip(names, allowed, strict=True)]
    yield from checks_of(values, rows, sizes)
    pair = assemble(paper_case(Mesh(128, grading=4.0)), comm)
    for ratio in reference.EDGE_EXPONENT:
        yield Check(f"edge exponent, E2/E1 = {ratio:g} (absolute error)", (128,),
                    (edge_error(pair, ratio),), 4e-3)  # fmt: skip


def edge_error(pair: ContactPair, ratio: float) -> float:
    """Return the error (absolute) of the edge exponent for E2/E1. Not collective.

    Parameters
    ----------
    pair : of the paper's rings, strongly graded; the exponent is that from 0.003 to 0.03 mm.
    """
    compliance = pair.compliance((10e3, 10e3 * min(ratio, 1e9)))
    line = compliance.line
    p = np.linalg.solve(compliance.matrix, line.area)
    s = (line.r - line.edges[0]) / 3.0
    near = (s > 1e-3) & (s < 1e-2)
    slope = np.polyfit(np.log(s[near]), np.log(p[near]), 1)[0]
    return abs(float(slope) - reference.EDGE_EXPONENT[ratio])


def tao_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare pressures of the paper's rings, smooth and rough, after a step. Collective on comm.

    Some elements are apart, some below the threshold of wear, some above.
    """
    case = paper_case(Mesh(_ELEMENTS))
    physics = Physics.of([case] * len(_HEIGHTS), assemble(case, comm))
    roughness = np.multiply.outer(_HEIGHTS, np.random.default_rng(1).random(_ELEMENTS))
    every, unworn = np.ones(len(_HEIGHTS)), np.zeros((2, len(_HEIGHTS), _ELEMENTS))
    time = _WEAR_STEP * every
    increment = physics.increment(time, physics.sliding(time), unworn, time)
    inputs = physics.contact_inputs(time, unworn, increment)

    def solution(tao_type: str) -> ContactState:
        compliances = physics.compliances.scaled()
        with ContactEngine(compliances, physics.compliances.which, tao_type) as engine:
            return engine.solve(inputs.gap + roughness, force=inputs.force, wear=inputs.wear)

    ours, *by_petsc = map(solution, TAO_TYPES)
    largest = ours.pressure.max(axis=1, keepdims=True)
    for tao_type, other in zip(TAO_TYPES[1:], by_petsc, strict=True):
        error = float((np.abs(other.pressure - ours.pressure) / largest).max())
        yield Check(
            f"contact with wear by TAO's {tao_type}: pressure", (_ELEMENTS,), (error,), 1e-8
        )
