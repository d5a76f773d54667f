"""Sizes of the random part of wear: as shares of depths while they are fitted, and as reported."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, ValidityWarning
from ringwear_par.identification.definition.problem import (
    Problem,
    ProcessNoise,
    Series,
    body_of_wear,
)
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.scatter.linearisation import MOST_READINGS
from ringwear_par.identification.scatter.posterior import DEGREES, ScatterPosterior, Size

#: of the logarithm of the prior's interval: a narrower one is told by the readings
_NARROW = 0.5


@dataclass(frozen=True, eq=False)
class RandomWear:
    """The bodies of a fit whose wear is random."""

    #: by key ("wear.lower")
    process: Mapping[str, ProcessNoise]
    #: (bodies,) mm, largest mean worn depth of each in any test
    depths: FloatArray
    #: (bodies,) mm, worn between two readings or blocks of them, the median of all
    steps: FloatArray
    #: of the process noise: sqrt(size / depth)
    shares: tuple[Size, ...]

    @classmethod
    def of(
        cls, misfit: Misfit, x: FloatArray, test_unknowns: FloatArray, *, plan: bool
    ) -> "RandomWear":
        """Return the bodies at unknowns (u,) and those of the keys in each test, (tests, m).

        In a plan, shares are known: half the scale of their priors. ComputationError where a body
        does not wear there.
        """
        process = misfit.problem.settings.process
        if not process:
            return cls(process, np.zeros(0), np.zeros(0), ())
        depths = misfit.clocks(x, test_unknowns)[1]
        steps = [
            np.diff(depths[rows], axis=0) * max(1.0, series.n / MOST_READINGS)
            for _, series, rows in misfit.records
            if series.n > 1 and not series.profile
        ]
        steps.append(depths[:0])
        largest = depths.max(axis=0)
        for key, depth in zip(process, largest.tolist(), strict=True):
            if not depth > 0.0:
                raise ComputationError(
                    f"{misfit.problem.name}: fit.process.{key}: nothing is worn off at the optimum"
                )
        shares = [
            _share(noise, depth, plan=plan)
            for noise, depth in zip(process.values(), largest.tolist(), strict=True)
        ]
        median = np.median(np.concatenate(steps), axis=0) if len(steps) > 1 else largest
        return cls(process, largest, median, tuple(shares))

    def sizes(self, shares: FloatArray) -> FloatArray:
        """Return the sizes (G, bodies) mm of shares (G, bodies)."""
        return shares**2 * self.depths

    @property
    def n_fitted(self) -> int:
        """Number of the sizes that are fitted."""
        return sum(share.known is None for share in self.shares)

    def estimated_shares(self, posterior: ScatterPosterior) -> FloatArray:
        """Return the shares (bodies,), the median of each that is fitted."""
        return np.array(
            [
                posterior.share(body, 0.5).median if share.known is None else share.known
                for body, share in enumerate(self.shares)
            ]
        )

    def entries(self, posterior: ScatterPosterior, level: float) -> dict[str, dict[str, Any]]:
        """Return the entries of each body in fit.json, intervals of a confidence level."""
        return {key: self._entry(body, posterior, level) for body, key in enumerate(self.process)}

    def _entry(self, body: int, posterior: ScatterPosterior, level: float) -> dict[str, Any]:
        depth, share = float(self.depths[body]), self.shares[body]
        if share.known is not None:
            size = {"known": share.known**2 * depth}
            return {"size": size, "share": {"known": share.known}, "depth": depth}
        of_share = posterior.share(body, level)
        low, high = of_share.interval
        verdict = "not identified"
        if of_share.at_bound:
            verdict = "at bound"
        elif np.log(high / low) < _NARROW * _prior_width(level):
            verdict = "identified"
        # increments are not normal where single events are larger than they
        coarse = of_share.median**2 * depth > self.steps[body]
        ends = None if coarse else [low**2 * depth, high**2 * depth]
        return {
            "size": {"estimate": of_share.median**2 * depth, "interval": ends},
            "share": {"estimate": of_share.median, "interval": None if coarse else [low, high],
                      "reml": of_share.restricted},
            "depth": depth,
            "verdict": verdict,
        }  # fmt: skip

    def warnings(self, entries: Mapping[str, Mapping[str, Any]]) -> Iterator[ValidityWarning]:
        """Yield warnings about sizes that readings do not tell."""
        for body, (key, entry) in enumerate(entries.items()):
            if "verdict" not in entry:
                continue
            size, step = 1e3 * entry["size"]["estimate"], 1e3 * float(self.steps[body])
            if entry["size"]["interval"] is None:
                text = (
                    f"wear of {body_of_wear(key)} comes in events of {size:.2g} um, but only "
                    f"{step:.2g} um is worn between two readings (or blocks of them): the interval "
                    "of this size is not known, those of the keys are"
                )
                values = {"size": 1e-3 * size, "step": 1e-3 * step}
                yield ValidityWarning("coarse-wear", text, (key,), (), values)
            if entry["verdict"] == "not identified":
                text = (
                    f"the readings hardly tell the noise of the wear of {body_of_wear(key)}: the "
                    "intervals of the keys hold what was assumed of it (fit.process, prior)"
                )
                yield ValidityWarning("process-from-prior", text, (key,))


def _share(noise: ProcessNoise, depth: float, *, plan: bool) -> Size:
    if noise.size is not None:
        return Size(float(np.sqrt(noise.size / depth)))
    if noise.share is not None:
        return Size(noise.share)
    return Size(0.5 * noise.scale if plan else None, noise.scale)


def _prior_width(level: float) -> float:
    """Return the logarithm of the upper over the lower end of the interval of a half-t prior."""
    low, high = student_t.ppf([0.75 - 0.25 * level, 0.75 + 0.25 * level], DEGREES)
    return float(np.log(high / low))


def confounded_with_drift(problem: Problem) -> dict[str, str]:
    """Return the keys of wear that free drifts hide in the noise of wear, and which drift each.

    Where no test has a weighing or a profile of the body, its wear could be all of the drift.
    """
    confounded: dict[str, str] = {}
    for of_wear in problem.settings.process:
        body = body_of_wear(of_wear)
        tests = [
            (experiment.name, series)
            for experiment in problem.experiments
            if (series := [s for s in experiment.series if s.tells_wear(body)])
        ]
        # a test without one series that does not drift
        drifting = [(name, s[0].name) for name, s in tests if all(map(_drifts, s))]
        if len(drifting) == len(tests):
            name, record = drifting[0]
            keys = [key for key in problem.keys if key.startswith(f"{of_wear}.")]
            confounded |= dict.fromkeys(keys, f"drift of {record} ({name})")
    return confounded


def _drifts(series: Series) -> bool:
    """Tell whether the drift of a record is free."""
    return any(nuisance.kind == "drift" and nuisance.free for nuisance in series.nuisances)
