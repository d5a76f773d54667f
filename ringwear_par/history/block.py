"""A block of B histories on one contact line: what their cases give them, as arrays."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.contact.problem import Compliance, Line
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.history.elastic import operator_key
from ringwear_par.schedules import Schedules, Table, padded, value
from ringwear_par.wear.step import StepWear, Wearing
from ringwear_par.wear.user import user


@dataclass(frozen=True)
class Cases:
    """The cases of a whole block, by the numbers of their histories."""

    every: tuple[Case, ...]
    #: what laws of users do wrong, by body and layer, and by number of the history
    faults: dict[tuple[int, int], dict[int, str]] = field(default_factory=dict)
    shared = True


@dataclass(frozen=True)
class Block:
    """Loads, laws, gaps and elasticity of B histories."""

    cases: Cases
    line: Line
    compliance: Compliance
    #: (B,) of the histories, in the whole block
    number: IntArray
    #: (B, n) mm, of the unworn faces
    gap: FloatArray
    #: N if ``by_force``, else mm
    load: Schedules
    by_force: bool
    #: rad/s, and coefficient
    omega: Schedules
    friction: Schedules
    #: w bodies that wear
    wearing: tuple[Wearing, ...]
    #: (B,) mm of wear, to which steps are held
    tolerance: FloatArray
    #: (B, m) s, times at which steps end, the last of them repeated, and which states are stored
    limits: FloatArray
    stored: BoolArray
    #: (B,) after how many steps a state is stored, 0 where times say it
    every: IntArray
    #: (B,) limits that end histories, by the name of a quantity in ``loop.STOP``
    stop: dict[str, FloatArray]
    #: (B, w) mm of wear at most; end elements that must stay free of contact
    deepest: FloatArray
    open_ends: tuple[int, ...]
    #: whether steps go from limit to limit, whatever their errors
    given_steps: bool
    #: (w, B, m) factors on the rates of wear in the steps to each limit; None: 1
    paces: FloatArray | None
    #: (w, B, 1) those of the present steps
    pace: FloatArray | None = None

    @classmethod
    def of(
        cls,
        cases: Sequence[Case],
        pairs: Sequence[ContactPair],
        step_times: Sequence[Sequence[float]] | None = None,
        paces: Sequence[FloatArray] | None = None,
    ) -> "Block":
        """Return the block of cases of one ``block_key``.

        Parameters
        ----------
        pairs : of each case.
        step_times : s, ends of the steps of each; None: those of the case.
        paces : (2, steps) each, factors on the rates of lower and upper in the steps given.
        """
        case, different = cases[0], {id(pair): pair for pair in pairs}
        order = {key: number for number, key in enumerate(different)}
        line, by_force = Line.of([*different.values()]), case.load.force is not None
        softness = np.array([[1.0 / c.lower.young, 1.0 / c.upper.young] for c in cases])
        pair = np.array([order[id(pair)] for pair in pairs])
        bodies = [i for i, laws in enumerate(case.laws) if laws]
        whole = Cases(tuple(cases))
        limits = padded(step_times or [_limits(c) for c in cases])
        stop = [dict(c.stop) for c in cases]
        loads = [c.load.force if by_force else c.load.displacement for c in cases]
        factors: Any = paces and np.array([*map(padded, zip(*paces, strict=True))])[bodies]
        return cls(
            cases=whole,
            line=line,
            compliance=Compliance.of(line, pair, softness),
            number=np.arange(len(cases)),
            gap=_gaps(cases, line.r),
            load=Schedules.of([0.0 if load is None else load for load in loads]),
            by_force=by_force,
            omega=Schedules.of([c.load.omega for c in cases]),
            friction=Schedules.of([c.friction for c in cases]),
            wearing=tuple(_wearing(whole, body, line) for body in bodies),
            tolerance=np.array([c.time.tolerance for c in cases]),
            limits=limits,
            stored=_stored(cases, limits),
            every=np.array([0 if c.output.times else c.output.every for c in cases]),
            stop={k: np.array([s.get(k, np.inf) for s in stop]) for s in stop for k in s},
            deepest=np.array([[0.5 * np.ptp(c.rings[i].z) for i in bodies] for c in cases]),
            open_ends=tuple(e for e, cut in zip((0, -1), case.open_ends, strict=True) if cut),
            given_steps=step_times is not None or not case.time.adaptive,
            paces=factors,
        )

    def __len__(self) -> int:
        return len(self.gap)

    @cached_property
    def layered(self) -> bool:
        """Whether a body has layers."""
        return any(len(body.laws) > 1 for body in self.wearing)

    def worn_gap(self, wear: FloatArray) -> FloatArray:
        """Return the gaps (B, n) mm of undeformed profiles worn by (w, B, n) mm."""
        return self.gap + total(wear)

    def both(self, wear: FloatArray) -> FloatArray:
        """Return the wear, or its rates, of lower and upper, (2, B, n), from those that wear."""
        both = np.zeros((2, *self.gap.shape))
        both[[body.body for body in self.wearing]] = wear
        return both

    def moment(self, p: FloatArray) -> FloatArray:
        """Return the friction torque over the coefficient of friction, (B,) N mm."""
        return p @ (self.line.true_area * self.line.r)

    def step_wear(
        self,
        layer: IntArray,
        time: FloatArray,
        sliding: tuple[FloatArray, FloatArray],
        wear: FloatArray,
        step: FloatArray,
    ) -> StepWear:
        """Return the wear of an implicit step at the present pace, see ``StepWear``.

        Parameters
        ----------
        sliding : (B,) rad/s and coefficient of friction.
        """
        r, (omega, friction) = self.line.r, sliding
        speed, slid = omega[:, None] * r, self.omega.integral(time)[:, None] * r
        return StepWear(
            self.wearing, self.line, layer, time[:, None], friction[:, None],
            self.number[:, None], speed, slid, wear, step[:, None], self.pace, np.zeros_like(wear),
        )  # fmt: skip

    def sliding(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return speeds (rad/s) and coefficients of friction at times, (B,)."""
        return self.omega.at(time), self.friction.at(time)


def total(of_bodies: FloatArray) -> FloatArray:
    """Return the sum over the bodies that wear, (w, B, n) to (B, n); of one without a copy."""
    return of_bodies[0] if len(of_bodies) == 1 else of_bodies.sum(axis=0)


def block_key(case: Case) -> Hashable:
    """Return the key of cases that can be in one block.

    They have the same contact elements, slopes of faces, open ends of the mesh, nominal areas, and
    layers on bodies that do not wear; other heights, moduli and Poisson's ratios, except where
    stresses are stored.
    """
    laws = tuple(tuple(law.key for law in of_body) for of_body in case.laws)
    elements = case.contact, case.mesh, *((ring.r, ring.face) for ring in case.rings)
    layers = tuple(
        len(ring.layers) if of_body else tuple(layer.thickness for layer in ring.layers)
        for ring, of_body in zip(case.rings, case.laws, strict=True)
    )
    output = case.output
    alone = id(case) if case.follows_wear or output.boundary != "none" else 0
    stress = case.stress and (case.stress, operator_key(case), case.lower.z[1], case.upper.z[0])
    stored = output.fields, output.profiles, bool(output.times), stress
    return case.time.scheme, case.load.force is not None, laws, elements, layers, *stored, alone


def _gaps(cases: Sequence[Case], r: FloatArray) -> FloatArray:
    """Return the gaps of the unworn faces at radii, (B, n) mm; faces differ in heights alone."""
    lower, upper = (section.depth(r) for section in cases[0].sections)
    return np.array([[c.upper.z[0] - c.lower.z[1]] for c in cases]) - lower - upper


def _limits(case: Case) -> list[float]:
    """Return the times at which steps of a case end."""
    time, steps = case.time, case.breakpoints
    if not time.adaptive:
        steps = tuple((time.step * np.arange(1, time.steps + 1)).tolist())
    times = np.array(sorted({*steps, *case.output.times, time.end}))
    apart = np.diff(times, prepend=0.0) > SAME_TIME * times
    return [*times[apart & (times <= time.end)][:-1], time.end]


def _stored(cases: Sequence[Case], limits: FloatArray) -> BoolArray:
    """Return which of the limits are times of output, (B, m)."""
    stored = np.zeros(limits.shape, bool)
    if cases[0].output.times:
        for times in padded([case.output.times for case in cases]).T[:, :, None]:
            stored |= np.abs(limits - times) <= SAME_TIME * times
    return stored


def _wearing(cases: Cases, body: int, line: Line) -> Wearing:
    """Return the laws of a body of all cases, layer by layer."""
    columns = [*zip(*(case.laws[body] for case in cases.every), strict=True)]
    none = np.full((1, len(line.r)), np.inf)
    ends = [
        np.concatenate([c.layer_ends(body), none]) if len(columns) > 1 else none
        for c in cases.every
    ]
    first = [column[0] for column in columns]
    return Wearing(
        body,
        tuple(
            partial(user, law.code, cases.faults.setdefault((body, layer), {}))
            if law.code
            else law.kind.function
            for layer, law in enumerate(first)
        ),
        tuple(
            {
                name: _stacked([law.arguments[name] for law in column], line.r)
                for name in column[0].arguments
            }
            for column in columns
        ),
        tuple(law.linear for law in first),
        tuple(law.remembers for law in first),
        np.array(ends).swapaxes(0, 1).copy(),
        np.array([[law.ratio(case.friction) for law in case.laws[body]] for case in cases.every]),
        first[-1].length,
    )


def _stacked(quantities: Sequence[Any], r: FloatArray) -> FloatArray | Schedules:
    """Return what a law takes of all cases: (B, 1); (B, n) or more of profiles; schedules."""
    first = quantities[0]
    if any(isinstance(q, Table) and q.axis == "r" for q in quantities):
        return np.array([np.broadcast_to(value(q, 0.0, r), r.shape) for q in quantities])
    if isinstance(first, np.ndarray):
        return np.array(quantities)
    schedules = Schedules.of(quantities)
    return schedules.y if schedules.constant else schedules
