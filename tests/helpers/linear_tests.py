"""Tests whose readings are linear in the unknowns: what fits make of them is known exactly."""

import numpy as np
from paths import PAPER

import ringwear_par as rw
from ringwear_par.identification.definition.problem import (
    DesignSpace,
    Experiment,
    FittedParameter,
    Problem,
    Series,
    Settings,
)
from ringwear_par.identification.emulator import Box, emulate

END = 100.0
CASE = rw.read_case(PAPER, {"time.scheme": "adaptive", "time.end": END})
KEYS = "wear.lower.k", "wear.lower.p0"


def series(value, sd=0.5, **more):
    """Return a record of a penetration at equal times, in units of its own."""
    x = np.linspace(END / len(value), END, len(value))
    given = {"name": "penetration", "quantity": "penetration", "x": x, "sd": sd + 0.0 * x, **more}
    return Series(value=np.asarray(value, dtype=float), **given)


def experiment(*of, name="A", groups=("A", "", "")):
    """Return a test with some series."""
    return Experiment(name, CASE, of, groups)


def parameter(number=0, bounds=(-5.0, 5.0), **more):
    """Return a fitted key, whose unknown is its value."""
    return FittedParameter(KEYS[number], 0.0, bounds, **more)


def problem(parameters, experiments, **settings):
    """Return a problem."""
    return Problem(
        "linear", "", Settings(**settings), tuple(parameters), tuple(experiments), {}, {},
        DesignSpace(),
    )  # fmt: skip


def box_of(low, high):
    """Return the box between bounds, (m,) each."""
    low, high = np.array(low, dtype=float), np.array(high, dtype=float)
    return Box(low, high, 0.5 * (low + high), np.diag(0.5 * (high - low)))


def emulator(mean, slopes, low, high):
    """Return the emulator of readings mean (n,) + slopes (n, m) times unknowns between bounds."""
    points = box_of(low, high).design(64)
    readings = mean + points @ np.transpose(slopes)
    return emulate(box_of(low, high), points, readings, np.ones(len(mean)), np.ones(64), 1e-9)[0]


class LinearReadings:
    """What takes the place of readings of histories: some functions of the unknowns (P, m)."""

    steps, count, failed, reason = 40, 0, 0, "no history there"

    def __init__(self, problem, *functions):
        self.problem, self._functions = problem, functions
        self.same_as = [*range(len(functions))]

    def tell(self, state):
        """Tell nobody."""

    def __call__(self, wanted, **_):
        """Return readings (P, n) of each test; NaN where there is none."""
        blocks = [self._functions[test](points) for test, points in wanted]
        self.count += sum(map(len, blocks))
        self.failed += sum(int(np.isnan(block).any(axis=1).sum()) for block in blocks)
        return blocks
