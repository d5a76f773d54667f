"""Running in: the paper's law with a coefficient that falls with worn depth or distance slid."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import Fault, InputError
from ringwear_par.schedules import Quantity, value
from ringwear_par.wear.law import Coefficient, Parameter, Threshold
from ringwear_par.wear.laws.threshold import AboveThreshold
from ringwear_par.wear.local_state import LocalState


@dataclass(frozen=True)
class RunningInLaw(AboveThreshold):
    """Wear that is faster at first and settles with worn depth or distance slid.

    The threshold law with a coefficient that falls from k_start to k (both in 1/MPa, volume lost by
    friction energy). The difference from k falls by the factor e with every ``depth`` worn off, or
    every ``distance`` slid, at the same place; give one of the two, in mm. With p0 = 0 the specific
    wear rate is k_start mu at first and k mu in the end.

    Use it where the first hours of a test wear faster than the rest at the same load: ``depth`` if
    a layer or the roughness is worn off, ``distance`` if surfaces or a transfer film settle. Fits
    need readings from both parts.

    k_start is at least k: wear that becomes faster with time needs tables in time or a law of your
    own. Depth and distance count at each place from the start of the case: a body that is turned
    to a fresh face, or refilled with lubricant, is a new case.

    Raises
    ------
    InputError : neither or both of them are given, or k_start is less than k, both numbers.
    """

    name = "running-in"
    formula = "(k + (k_start - k) exp(-s)) mu max(0, p - p0) V (s = wear/depth or slid/distance)"
    line = AboveThreshold.line

    k: Coefficient
    k_start: Annotated[
        Quantity, Parameter("1/MPa", "wear coefficient at the start, k or larger", at_least="k")
    ]
    p0: Threshold = 0.0
    depth: Annotated[
        float | None,
        Parameter(
            "mm", "worn depth over which k_start - k falls by the factor e", "number", ends=False
        ),
    ] = None
    distance: Annotated[
        float | None,
        Parameter(
            "mm",
            "distance slid over which k_start - k falls by the factor e, instead of depth",
            "number",
            ends=False,
        ),
    ] = None

    def __post_init__(self) -> None:
        values = {name: getattr(self, name) for name in ("k", "k_start", "depth", "distance")}
        # tables, and arrays of many histories, were checked where they came from
        numbers = {n: v for n, v in values.items() if v is None or isinstance(v, float | int)}
        if faults := self.faults("", numbers):
            raise InputError(*faults)

    @classmethod
    def faults(cls, table: str, values: Mapping[str, Any]) -> list[Fault]:
        """Return the faults of depth and distance together, and those of any law."""
        faults = []
        if {"depth", "distance"} <= values.keys() and (values["depth"] is None) == (
            values["distance"] is None
        ):
            sentence = f"{table}depth, {table}distance: one of them must be given (mm)"
            faults.append(Fault(sentence, f"{table}depth", "missing"))
        return faults + super().faults(table, values)

    @property
    def remembers(self) -> bool:
        """Whether worn depth is what it remembers."""
        return self.depth is not None

    def _over(self, local: LocalState) -> tuple[FloatArray, float]:
        """Return the memory, mm, and over how much of it, mm, the coefficient falls."""
        if self.depth is not None:
            return local.wear, self.depth
        assert self.distance is not None
        return local.slid, self.distance

    def _fresh(self, local: LocalState) -> FloatArray:
        """Return (k_start - k) exp(-s)."""
        self._line(local)
        fresh: FloatArray = local.memo[3]
        return fresh

    def _line(self, local: LocalState) -> tuple[FloatArray, float | FloatArray]:
        memo = local.memo
        if not memo or memo[0] is not self:
            fresh, k = self._not_run_in(local), value(self.k, local.time, local.r)
            p0 = value(self.p0, local.time, local.r)
            memo[:] = self, (k + fresh) * local.power, p0, fresh
        return memo[1], memo[2]

    def _not_run_in(self, local: LocalState) -> FloatArray:
        fall = value(self.k_start, local.time, local.r) - value(self.k, local.time, local.r)
        memory, over = self._over(local)
        return fall * np.exp(-(memory / over))

    def depth_in_step(
        self, p: FloatArray, local: LocalState, step: float | FloatArray
    ) -> FloatArray | None:
        """Return the depth d = step rate(p, wear + d) of an implicit step, mm.

        With Lambert's W, d = depth (a + W(b exp(-a))), a and b being what k and the rest of the
        coefficient wear in the step over ``depth``.
        """
        if self.depth is None:
            return None
        sliding = (step / self.depth) * local.power * self._excess(p, local)
        settled = sliding * value(self.k, local.time, local.r)
        fresh = sliding * self._fresh(local)
        return self.depth * (settled + _lambert_w(fresh * np.exp(-settled)))

    def d_rate_dwear(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``local.wear``, 1/s."""
        if self.depth is None:
            return np.zeros_like(p)
        return -self._fresh(local) / self.depth * local.power * self._excess(p, local)


def _lambert_w(z: FloatArray) -> FloatArray:
    """Return W where W exp(W) = z >= 0, to round-off, by two of Halley's iterations.

    The start, by Winitzki (2003), is within 2 %.
    """
    log = np.log(1.0 + z)
    w = log * (1.0 - np.log(1.0 + log) / (2.0 + log))
    for _ in range(2):
        rest = z * np.exp(-w)
        rise = 1.0 + rest
        w -= 2.0 * (w - rest) * rise / (2.0 * rise * rise + (w - rest) * rest)
    return w
