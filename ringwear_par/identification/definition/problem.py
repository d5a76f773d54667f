"""What is to be fitted to which measurements, complete and consistent, as frozen dataclasses."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from ringwear_par import schedules
from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.files.smoothing import Smoothing, curve


@dataclass(frozen=True)
class ReadingKind:
    """A kind of readings, as "penetration", or "profile" of the quantity "profile.lower"."""

    #: of the readings within the program
    unit: str
    #: kinds that these readings may have
    nuisances: tuple[str, ...]
    #: the variable of a history that is read in time, "worn_volume" of a body; None: it is read
    #: along the radius, or once
    variable: str | None
    #: whether its quantities name a body
    of_body: bool = False
    #: whether they are of what is worn off: of the body that the quantity names, or of both
    of_wear: bool = True


_OF_RIGS = ("offset", "drift", "compliance", "thermal")
READING_KINDS = {
    "penetration": ReadingKind("mm", _OF_RIGS, "penetration"),
    "approach": ReadingKind("mm", _OF_RIGS, "approach"),
    "torque": ReadingKind("N mm", ("offset", "drift"), "torque", of_wear=False),
    "profile": ReadingKind("mm", ("level", "tilt"), None, of_body=True),
    "mass": ReadingKind("g", ("offset",), "worn_volume", of_body=True),
    "volume": ReadingKind("mm^3", ("offset",), "worn_volume", of_body=True),
    "through": ReadingKind("s", (), None, of_body=True),
}
#: the quantities that a series may be of
QUANTITIES = tuple(
    quantity
    for name, kind in READING_KINDS.items()
    for quantity in ([f"{name}.{body}" for body in BODIES] if kind.of_body else [name])
)
#: units of readings and numbers within the program; forces of a compliance are in kN
BASE = {
    "time": "s", "r": "mm", "force": "N", "pressure": "MPa", "omega": "rad/s",
    **{name: kind.unit for name, kind in READING_KINDS.items()},
}  # fmt: skip
Loss = Literal["gaussian", "student"]
Criterion = Literal["D", "A"]


class Prior(NamedTuple):
    """What is known before the measurements: a normal distribution."""

    mean: float
    sd: float


#: groups of tests between which values may scatter, the smallest first, and their plurals
PLURALS = {"specimen": "specimens", "batch": "batches", "lab": "laboratories"}
GROUPS = (*PLURALS,)


@dataclass(frozen=True)
class Scatter:
    """How the value of a key differs between specimens, batches and laboratories.

    Sizes are standard deviations of the key's unknown.
    """

    #: sizes by the name of the groups; None where the size is fitted
    sizes: Mapping[str, float | None]
    #: of the half-t prior of sizes that are fitted
    scale: float = 0.3
    #: sizes that a dry run and a design assume for those that are to be fitted
    start: float = 0.15

    @property
    def variance(self) -> float:
        """What a dry run and a design assume of all groups together."""
        return sum((self.start if s is None else s) ** 2 for s in self.sizes.values())


@dataclass(frozen=True)
class ProcessNoise:
    """How the wear of a body is itself random.

    Its worn depth is a gamma process, of a variance of size times mean. The share is the standard
    deviation over the depth, at the end of the test that wears most.
    """

    #: mm, and of 1; both None where the size is fitted
    size: float | None = None
    share: float | None = None
    #: of the half-t prior of the share where it is fitted
    scale: float = 0.1

    @property
    def fitted(self) -> bool:
        """Whether its size is fitted."""
        return self.size is None and self.share is None


def body_of_wear(key: str) -> str:
    """Return the body ("lower", "upper") of a key such as "wear.lower" or "wear.lower.k"."""
    return key.split(".")[1]


@dataclass(frozen=True)
class FittedParameter:
    """A case key whose value is fitted.

    Its unknown is the value itself or, where ``log``, its natural logarithm.
    """

    #: dotted case key
    key: str
    #: in the case's unit
    start: float
    bounds: tuple[float, float]
    log: bool = False
    prior: Prior | None = None
    #: None: all tests have the same value
    scatter: Scatter | None = None
    #: as the user writes it, "" for the case's
    unit: str = ""

    def unknown(self, value: Any) -> Any:
        """Return the unknown of a value, or those of an array."""
        return np.log(value) if self.log else value

    def value(self, unknown: Any) -> Any:
        """Return the value of an unknown, or those of an array, within the bounds to the bit."""
        if self.log:  # an exponential may overflow
            low, high = map(self.unknown, self.bounds)
            unknown = np.exp(np.clip(unknown, low - 1.0, high + 1.0))
        return np.clip(unknown, *self.bounds)

    def reflected_value(self, unknown: FloatArray) -> FloatArray:
        """Return the values of unknowns, those beyond the bounds reflected to their inside."""
        values: FloatArray = self.value(reflected(unknown, *map(self.unknown, self.bounds)))
        return values


def reflected(points: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return points (..., m), those beyond the bounds (m,) reflected to their inside."""
    beyond = low + np.mod(points - low, 2.0 * (high - low))
    return np.where(beyond > high, 2.0 * high - beyond, beyond)


#: kind of the time constant of "thermal", which it follows; the only one that is not linear
GROWTH_TIME = "thermal time"


def friction_power(case: Case) -> tuple[FloatArray, FloatArray]:
    """Return mu F omega (N/s) of a case under force at the times (s) where its schedules bend."""
    load = case.load
    assert load.force is not None
    times = np.array([0.0, *schedules.breakpoints(case.friction, load.force, load.omega)])
    factors = [schedules.in_time(q, times) for q in (case.friction, load.force, load.omega)]
    return times, np.prod(factors, axis=0)


@dataclass(frozen=True)
class Nuisance:
    """An unknown part of a measurement, as an offset or a drift, besides the measured quantity."""

    #: "offset", "drift" (in total over the test), "compliance" (per kN), "level", "tilt" (per mm
    #: of radius), "thermal" (the growth of a warm rig in the end), or its time constant
    kind: str
    #: in the measurement's unit; s of a time constant
    prior: Prior | None = None
    bounds: tuple[float, float] = (-np.inf, np.inf)
    #: s, of a time constant
    start: float = 0.0
    #: of thermal growth and its time constant: whether it goes with the friction power
    power: bool = False

    @property
    def expected(self) -> float:
        """Its value before any reading: the mean of its prior, or its start."""
        return self.start if self.prior is None else self.prior.mean

    @property
    def free(self) -> bool:
        """Whether readings alone determine it: it has no prior, and a side without bound."""
        return self.prior is None and np.inf in map(abs, self.bounds)


@dataclass(frozen=True, eq=False)
class Series:
    """Readings of one quantity in one experiment."""

    #: unique within the experiment
    name: str
    #: what was read
    quantity: str
    #: (n,) s, or mm of a profile
    x: FloatArray
    #: (n,) mm, N mm, g or mm^3
    value: FloatArray
    sd: FloatArray
    #: whether ``sd`` is but a first guess
    sd_fitted: bool = False
    #: the unit of the data, and how much it is in those above
    unit: str = "mm"
    factor: float = 1.0
    #: s, of a profile
    at: float | None = None
    #: g/mm^3, of all that a mass is of; None: each layer has its own, which the case tells
    density: float | None = 1.0
    #: nuisances, which are fitted with the keys
    nuisances: tuple[Nuisance, ...] = ()
    #: s, of the noise; 0: it is white
    correlation_time: float = 0.0
    #: where the readings stand; "" and none of a single value
    file: str = ""
    lines: IntArray | None = None
    #: whether nothing has been read yet; values are 0 then
    planned: bool = False
    #: (low, high) of what was left out, s or mm
    excluded: tuple[tuple[float, float], ...] = ()
    #: (n,) -1 where the true value is at most the reading, 1 where it is at least; None: nowhere
    censored: IntArray | None = None

    @property
    def n(self) -> int:
        """Number of readings."""
        return len(self.x)

    @property
    def kind(self) -> str:
        """A name in ``READING_KINDS``."""
        return self.quantity.partition(".")[0]

    @property
    def linear_nuisances(self) -> "tuple[Nuisance, ...]":
        """Its nuisances but for the time of thermal growth."""
        return tuple(nuisance for nuisance in self.nuisances if nuisance.kind != GROWTH_TIME)

    @property
    def growth_time(self) -> "Nuisance | None":
        """The time of its thermal growth, if there is any."""
        return next((n for n in self.nuisances if n.kind == GROWTH_TIME), None)

    @property
    def profile(self) -> bool:
        """Whether it is read along the radius."""
        return self.kind == "profile"

    @property
    def timed(self) -> bool:
        """Whether it is read at times; a profile and the end of a layer are of all the history."""
        return READING_KINDS[self.kind].variable is not None

    @property
    def body(self) -> Literal["lower", "upper"]:
        """The body that a profile, mass, volume or layer is of."""
        return "upper" if self.quantity.endswith(".upper") else "lower"

    def part(self, rows: BoolArray | IntArray) -> "Series":
        """Return some of the readings: a mask (n,), or numbers in their order."""
        lines, censored = (None if of is None else of[rows] for of in (self.lines, self.censored))
        return replace(
            self, x=self.x[rows], value=self.value[rows], sd=self.sd[rows], lines=lines,
            censored=censored,
        )  # fmt: skip

    def tells_wear(self, body: str) -> bool:
        """Tell whether it is of what is worn off a body."""
        of_both = "." not in self.quantity
        return READING_KINDS[self.kind].of_wear and (of_both or self.body == body)


def records(every: Sequence[Series]) -> list[tuple[Series, slice]]:
    """Return each series, and where its readings are if all follow one another."""
    ends = np.cumsum([0, *(series.n for series in every)]).tolist()
    return list(zip(every, map(slice, ends, ends[1:]), strict=True))


@dataclass(frozen=True, eq=False)
class MeasuredInput:
    """A quantity of a test's case over time, as the rig measured it."""

    #: "contact.friction", "load.force", "load.pressure" or "load.omega"
    key: str
    #: what was read: N mm of the torque of a friction, else in the key's unit
    series: Series
    smooth: Smoothing = "auto"
    #: prior of a factor on the readings; None: they are exact
    scale: Prior | None = None
    #: mm, at which friction acts by the pressures of the test, a number or a table in time
    radius: schedules.Quantity = 0.0

    @property
    def of_torque(self) -> bool:
        """Whether a torque was read, which tells the friction."""
        return self.key == "contact.friction"

    def readings(self, case: Case) -> FloatArray:
        """Return the readings in the key's unit, (n,), as their calibration has them."""
        mean = 1.0 if self.scale is None else self.scale.mean
        if not self.of_torque:
            return mean * self.series.value
        assert case.load.force is not None
        force, radius = (
            schedules.in_time(q, self.series.x) for q in (case.load.force, self.radius)
        )
        return mean * self.series.value / (force * radius)

    def curve(self, case: Case) -> schedules.Table:
        """Return the curve through the readings."""
        return curve(self.series.x, self.readings(case), self.smooth, case.time.end)

    def applied(self, case: Case) -> Case:
        """Return a case in which the key is the curve through the readings."""
        return case.replace({self.key: schedules.points_of(self.curve(case))})


@dataclass(frozen=True, eq=False)
class Experiment:
    """One test: its case, with the fitted keys at their starts, and what was read of it."""

    name: str
    case: Case
    series: tuple[Series, ...]
    #: names of the specimen, its batch and the laboratory
    groups: tuple[str, str, str] = ("", "", "")
    #: what of the case was measured
    inputs: tuple[MeasuredInput, ...] = ()
    #: of a test that could be made: the keys that vary
    changes: Mapping[str, float] = field(default_factory=dict)

    @property
    def torque_input(self) -> MeasuredInput | None:
        """The measured friction, if there is one."""
        return next((entry for entry in self.inputs if entry.of_torque), None)

    @property
    def conditions(self) -> str:
        """The text of its case without measured friction: that of repeats is the same."""
        if self.torque_input is None:
            return self.case.text
        return self.case.replace({"contact.friction": 1.0}).text

    def with_radius(self, radius: schedules.Quantity) -> "Experiment":
        """Return the test with the friction that the torque tells at a radius, mm."""
        inputs = tuple(replace(i, radius=radius) if i.of_torque else i for i in self.inputs)
        changed = replace(self, inputs=inputs)
        assert changed.torque_input is not None
        return replace(changed, case=changed.torque_input.applied(self.case))

    @property
    def n(self) -> int:
        """Number of readings."""
        return sum(series.n for series in self.series)

    @property
    def times(self) -> FloatArray:
        """When each reading was made, (n,) s."""
        return np.concatenate([np.full(s.n, s.at) if s.profile else s.x for s in self.series])


@dataclass(frozen=True)
class Settings:
    """How to fit."""

    #: of the intervals
    level: float = 0.95
    #: "gaussian", or "student" (with 4 degrees of freedom) where there are outliers
    loss: Loss = "gaussian"
    #: of bodies whose wear is itself random, by "wear.lower", "wear.upper"
    process: Mapping[str, ProcessNoise] = field(default_factory=dict)


@dataclass(frozen=True)
class DesignSpace:
    """What ``[design]`` asks."""

    #: "D", the determinant of the information; "A", the mean variance
    criterion: Criterion = "D"
    #: lowest and highest value of each key that varies
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: at most, of all experiments together
    seconds: float = math.inf
    #: how many
    experiments: int = 1
    #: in which ranges are written, by key; of others the case's own
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Problem:
    """What a fit file asks."""

    #: what messages call it
    name: str
    #: the TOML text
    text: str
    settings: Settings
    #: fitted; the same in all experiments
    parameters: tuple[FittedParameter, ...]
    experiments: tuple[Experiment, ...]
    #: other laws with parameters of their own, by name
    alternatives: "Mapping[str, Problem]"
    #: SHA-256 of the files of data, by their names in the fit file
    hashes: Mapping[str, str]
    #: what tests may be made next
    design: DesignSpace

    @property
    def keys(self) -> tuple[str, ...]:
        """The fitted keys."""
        return tuple(parameter.key for parameter in self.parameters)

    def unknowns(self, values: Sequence[float] | FloatArray) -> FloatArray:
        """Return the unknowns (..., m) of values of the fitted keys."""
        columns = zip(self.parameters, np.moveaxis(np.asarray(values), -1, 0), strict=True)
        return np.stack([p.unknown(column) for p, column in columns], axis=-1)

    def values(self, unknowns: FloatArray) -> FloatArray:
        """Return the values (..., m) of unknowns."""
        columns = zip(self.parameters, np.moveaxis(unknowns, -1, 0), strict=True)
        return np.stack([p.value(column) for p, column in columns], axis=-1)

    @property
    def unknown_bounds(self) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest unknowns, (m,)."""
        low, high = self.unknowns(np.array([p.bounds for p in self.parameters]).T)
        return low, high
