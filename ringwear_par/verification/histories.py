"""The paper's rings: contact, methods of TAO; histories against steady laws, balances, limits."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from ringwear_par.cases.case import Case, Load, Output, Ring, Stepping
from ringwear_par.contact.engine import TAO_TYPES, ContactEngine
from ringwear_par.contact.problem import ContactState
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.elasticity.sections import Polyline
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.observers.trace import Trace, trace
from ringwear_par.history.physics import Physics
from ringwear_par.history.refusals.stable_steps import stable_steps
from ringwear_par.history.start import first_contact
from ringwear_par.verification import reference
from ringwear_par.verification.check import NU, SIZES, Check, bound, checks_of, identity
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
    rows = [
        (f"paper, 50 MPa: {name}", *limits) for name, limits in zip(names, allowed, strict=True)
    ]
    yield from checks_of(values, rows, sizes)
    pair = assemble(paper_case(Mesh(128, grading=4.0)), comm)
    for ratio in reference.EDGE_EXPONENT:
        yield Check(f"edge exponent, E2/E1 = {ratio:g} (absolute error)", (128,),
                    (edge_error(pair, ratio),), 4e-3)  # fmt: skip


def edge_error(pair: ContactPair, ratio: float) -> float:
    """Return the error (absolute) of the edge exponent for E2/E1. Not collective.

    It is that from 0.003 to 0.03 mm of the paper's rings, strongly graded.
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
    for tao_type, petsc_result in zip(TAO_TYPES[1:], by_petsc, strict=True):
        error = float((np.abs(petsc_result.pressure - ours.pressure) / largest).max())
        yield Check(
            f"contact with wear by TAO's {tao_type}: pressure", (_ELEMENTS,), (error,), 1e-8
        )


#: contact elements of the paper's rings
_N = 64
_LONG = Stepping("implicit", 40.0, 200)
#: of both bodies where both wear, 1/MPa
_BOTH = (1e-7, 3e-7)


def history_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare wear histories with what is known of them. Collective on comm."""
    pair = assemble(paper_case(Mesh(_N)), comm)
    yield from steady_checks(pair, comm)
    yield from adaptive_checks(pair, comm)
    yield from pin_checks(comm)
    yield from growing_checks(comm)
    yield Check("explicit limit 1.485 h p/E*, uniform mesh", (128,),
                (explicit_limit_error(128, comm),), 2e-2)  # fmt: skip


def _steady_constant(case: Case, p0: float) -> float:
    """Return c of a case's steady pressure p0 + c/r."""
    assert isinstance(case.load.force, float)
    return reference.steady_constant(case.load.force, p0, *case.contact)


def _approach_rate(history: Trace) -> float:
    """Return the rate of the approach in the last step, mm/s."""
    before, after = history.states[-2:]
    return (after.contact.approach - before.contact.approach) / history.physics.case.time.step


def steady_checks(pair: ContactPair, comm: MPI.Comm) -> Iterator[Check]:
    """Compare long histories of the paper's rings with the steady laws and balances."""
    for p0 in (0.0, 40.0):
        case = paper_case(Mesh(_N), p0=(p0, None), stepping=_LONG)
        history = trace(case, comm, pair=pair)
        c = _steady_constant(case, p0)
        exact = p0 + c / pair.line.arm
        error = np.abs(history.last.contact.pressure / exact - 1.0).max()
        yield Check(f"steady pressure p0 + c/r, p0 = {p0:g} MPa", (_N,), (float(error),), 1e-3)
        kappa = case.friction_at(0.0) * 1e-7
        yield Check(f"steady approach rate kappa omega c, p0 = {p0:g} MPa", (_N,),
                    (abs(_approach_rate(history) / (kappa * OMEGA * c) - 1.0),), 1e-3)  # fmt: skip
        worst = history.balances
        if p0 == 0.0:
            yield identity("worn volume = k x dissipated energy, worst of all steps", _N,
                           worst.energy, 1e-10)  # fmt: skip
        said = f"worst of all steps, p0 = {p0:g} MPa"
        yield identity(f"force balance, {said}", _N, worst.force, 1e-10)
        yield identity(f"volume balance, {said}", _N, worst.volume, 1e-12)

    fixed = paper_case(Mesh(_N), p0=(0.0, None), stepping=_LONG)
    fixed = replace(fixed, load=Load(fixed.load.omega, displacement=0.0585))
    pressure = trace(fixed, comm, pair=pair).last.contact.pressure
    mean = 80.0  # MPa, at the start
    yield bound("fixed approach: pressure falls to 0, relative to its first mean", _N,
                float(pressure.max()) / mean, 1e-3)  # fmt: skip


def adaptive_checks(pair: ContactPair, comm: MPI.Comm) -> Iterator[Check]:
    """Compare adaptive histories of the paper's rings with finer ones, steady laws, similarity."""

    def history(case: Case, end: float, tolerance: float = 1e-5) -> Trace:
        stepping = Stepping("adaptive", until=end, tolerance=tolerance)
        return trace(replace(case, time=stepping), comm, pair=pair)

    for p0 in (0.0, 40.0):
        case = paper_case(Mesh(_N), p0=(p0, None))
        for end, most in ((200.0, 20), (2000.0, 30)):
            result = history(case, end)
            error = np.abs(result.last.wear - history(case, end, 1e-9).last.wear).max()
            yield Check(f"adaptive, p0 = {p0:g} MPa, {end:g} s: wear, mm", (_N,),
                        (float(error),), 1e-5)  # fmt: skip
            yield bound(f"adaptive, p0 = {p0:g} MPa, {end:g} s: number of steps", _N,
                        float(result.steps), float(most))  # fmt: skip

    thresholds = (40.0, 60.0)
    both = paper_case(Mesh(_N), p0=thresholds, k=_BOTH)
    p = history(both, 8000.0).last.contact.pressure
    mean = (_BOTH[0] * thresholds[0] + _BOTH[1] * thresholds[1]) / sum(_BOTH)
    error = np.abs(p / (mean + _steady_constant(both, mean) / pair.line.arm) - 1.0).max()
    yield Check("both wear, thresholds 40 and 60 MPa: steady pressure", (_N,),
                (float(error),), 1e-3)  # fmt: skip

    slow = history(paper_case(Mesh(_N), p0=(0.0, 0.0), k=_BOTH), 300.0)
    fast = history(paper_case(Mesh(_N), p0=(0.0, 0.0), k=(2e-7, 6e-7)), 150.0)
    yield identity("similarity: wear of twice k in half the time", _N,
                   float(np.abs(fast.last.wear / slow.last.wear - 1.0).max()), 1e-8)  # fmt: skip


def pin_case(n: int) -> Case:
    """Return the case of a solid pin, r = 0 to 3 mm under 3000 N, that wears until steady."""
    return Case(
        Ring((0.0, 10.0), (0.0, 10.0), 200e3, NU, "clamped"),
        Ring((0.0, 3.0), (10.0, 20.0), 200e3, NU, "clamped"),
        0.1, None, ThresholdLaw(1e-6), Load(1.0, 3000.0), Stepping("implicit", 2.5e4, 10), Mesh(n),
        Output(),
    )  # fmt: skip


def pin_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare a worn solid pin with its steady state, p = F / (2 pi R r) up to the axis."""
    histories = [trace(pin_case(n), comm) for n in SIZES]
    history = histories[SIZES.index(_N)]
    case = history.physics.case
    assert isinstance(case.load.force, float)
    force, (_, radius) = case.load.force, case.upper.r
    c = force / (2.0 * math.pi * radius)
    p, mu = history.last.contact.pressure, case.friction_at(0.0)
    for text, value, exact in (
        ("pressure F / (2 pi R r)", p * history.physics.line.r, c),
        ("torque mu F R / 2", history.physics.torque(p)[0], 0.5 * mu * force * radius),
        ("approach rate mu k omega F / (2 pi R)", _approach_rate(history),
         mu * 1e-6 * 1.0 * c),
    ):  # fmt: skip
        error = float(np.abs(value / exact - 1.0).max())
        yield Check(f"worn solid pin, steady: {text}", (_N,), (error,), 1e-4)
    yield identity("worn solid pin: worn volume = k x dissipated energy", _N,
                   history.balances.energy, 1e-10)  # fmt: skip
    torques = tuple(result.balances.torque for result in histories)
    yield Check("worn solid pin: torque on the held faces", SIZES, torques, 1e-5, kind="identity")


def round_face(r: tuple[float, float], radius: float) -> Polyline:
    """Return the face of a sphere (inner radius 0) or of a torus between two radii, 200 points."""
    samples = np.linspace(*r, 200)
    middle = 0.0 if r[0] == 0.0 else 0.5 * sum(r)
    fall = np.sqrt(radius**2 - (samples - middle) ** 2) - radius
    return tuple((float(a), float(b)) for a, b in zip(samples, fall, strict=True))


def growing_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Check the balances of a sphere and a torus that wear while their contact grows."""
    for name, r in (("sphere", (0.0, 3.0)), ("torus", (18.0, 22.0))):
        case = replace(
            paper_case(Mesh(48, grading=1.0)),
            lower=Ring((0.0, 30.0), (0.0, 20.0), 2e5, NU, "clamped"),
            upper=Ring(r, (20.0, 30.0), 2e5, NU, "clamped", round_face(r, 40.0)),
            wear_lower=None, wear_upper=ThresholdLaw(1e-6), load=Load(1.0, 300.0),
            time=Stepping("adaptive", until=400.0),
        )  # fmt: skip
        history = trace(case, comm)
        first, last = (
            np.count_nonzero(state.contact.pressure) for state in (history.states[0], history.last)
        )
        said = f"worn {name}, contact of {first} to {last} elements"
        volume, energy = history.balances.volume, history.balances.energy
        # what does not grow checks nothing
        yield identity(f"{said}: volume balance", 48, volume if last > first else math.inf, 1e-10)
        yield identity(f"{said}: worn volume = k x energy", 48, energy, 1e-10)


def explicit_limit_error(n: int, comm: MPI.Comm) -> float:
    """Return the error of the largest stable explicit step on a uniform mesh, rigid upper ring.

    The rings are wide (r = 300 mm), so that the sliding speed hardly varies along the contact.
    """
    case = paper_case(Mesh(n, grading=1.0), p0=(0.0, None), young=1e13)
    case = replace(
        case,
        lower=replace(case.lower, r=(290.0, 310.0)),
        upper=replace(case.upper, r=(298.5, 301.5)),
    )
    physics = Physics.of([case], assemble(case, comm))
    with physics.contacts() as contacts:
        (step,) = stable_steps(physics, contacts)
    fastest = 1e-7 * case.friction_at(0.0) * OMEGA * float(physics.line.arm.max())  # mm/s per MPa
    wear = step * fastest
    modulus = reference.contact_modulus((case.lower.young, NU))
    return abs(wear * modulus / (3.0 / n) / reference.EXPLICIT_LIMIT - 1.0)
