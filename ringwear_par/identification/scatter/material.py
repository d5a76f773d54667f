"""The material behind specimens that differ: its values, how they scatter, and each specimen's."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student_t

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.schema import base_unit
from ringwear_par.errors import ValidityWarning
from ringwear_par.identification.definition.fitted_parameters import unit_scale
from ringwear_par.identification.definition.problem import FittedParameter
from ringwear_par.identification.definition.scatter import PLURALS
from ringwear_par.identification.estimation.intervals import (
    ParameterEstimate,
    judged,
)
from ringwear_par.identification.estimation.misfit import Evaluation
from ringwear_par.identification.scatter.likelihood import ReducedTest
from ringwear_par.identification.scatter.posterior import (
    Mixture,
    ScatterPosterior,
    Size,
    SizePosterior,
)
from ringwear_par.identification.scatter.random_wear import RandomWear

#: ISO 5725: factor on an sd, for the difference of two results that one pair in twenty exceeds
_LIMIT = 2.8
#: sd above which the linear end of an interval is doubted
_MOST_BENT = 0.2
#: draws of the posterior in pieces, whose quantiles are then known to 0.01 sd
_DRAWS = 100_000
#: number of groups up to which the prior says more about a size than they do
_FEW = 2
#: probability of the sizes at which limits have not settled from which a warning tells of it
_UNSETTLED = 0.01
#: relative half width of the material's interval that specimens are counted for, and most specimens
_WANTED, _MOST_SPECIMENS = 0.10, 10_000


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a posterior, linearised about a place of its own."""

    posterior: ScatterPosterior
    #: its probability
    weight: float
    #: (tests, m) unknowns of the keys in each test, about which these are linearised
    test_unknowns: FloatArray


@dataclass(frozen=True, eq=False)
class MixedRound:
    """The mixed model of one round of the search for a material."""

    #: numbers of the keys that are not at their bounds
    free: tuple[int, ...]
    #: of these, and of all keys as if there were no bounds
    posterior: ScatterPosterior
    unbounded: ScatterPosterior
    #: mm, of the process noise of bodies; normal equations of the free keys there
    sizes: FloatArray
    reduced: Sequence[ReducedTest]
    #: (m,) means of the material's unknowns, (tests, m) of each test's, and their sd
    material: FloatArray
    of_tests: FloatArray
    sds: FloatArray


@dataclass(frozen=True, eq=False)
class BestFit:
    """The best fit of all tests, the random part of their wear included."""

    #: (u,) unknowns: the means of the material's, and the best nuisances of all tests
    x: FloatArray
    evaluation: Evaluation
    #: (n,) share of each reading that is fitted
    leverage: FloatArray
    #: number of keys, and by how much readings determine deviations of specimens and of wear
    effective_number: float
    #: (n, bodies) mm, by which bodies have worn more than their mean, and its sd
    excess: FloatArray
    excess_sd: FloatArray


@dataclass(frozen=True, eq=False)
class Material:
    """What a fit with scatter knows of the material and of its specimens."""

    parameters: tuple[FittedParameter, ...]
    mixed: MixedRound
    best_fit: BestFit
    sizes: tuple[Size, ...]
    #: names of the groups of each level
    names: tuple[tuple[str, ...], ...]
    #: (tests, m) of the unknowns by one test, the others as estimated; NaN and infinity for none
    alone: FloatArray
    alone_sd: FloatArray
    #: of intervals
    level: float
    #: (tests, m) unknowns of the keys in each test
    test_unknowns: FloatArray
    #: (u, u) of the unknowns, and (n,) sd of the model's readings
    covariance: FloatArray
    band: FloatArray
    #: -2 log likelihood of the readings with the priors' squares, nuisances at their best
    deviance: float
    #: whether the values of tests have converged
    converged: bool
    #: bodies whose wear is random
    wear: RandomWear
    #: keys that readings do not tell from drifts, and which these are
    confounded_with_drift: Mapping[str, str]
    #: of the posterior without linearising about the estimate; none where that does
    pieces: tuple[Piece, ...] = ()
    #: what is wrong with these, or that there are none
    doubt_of_pieces: str = ""

    @property
    def parts(self) -> tuple[Piece, ...]:
        """The pieces, or the whole posterior as one."""
        return self.pieces or (Piece(self.mixed.posterior, 1.0, self.test_unknowns),)

    @property
    def n_fitted_sizes(self) -> int:
        """Number of the sizes that were fitted."""
        return sum(size.known is None for size in self.sizes) + self.wear.n_fitted

    @property
    def process(self) -> dict[str, dict[str, Any]]:
        """Entries of fit.json of each body whose wear is random."""
        return self.wear.entries(self.mixed.posterior, self.level)

    @property
    def sizes_of_process(self) -> FloatArray:
        """(bodies,) mm, the median where it was fitted."""
        return self.wear.sizes(self.wear.estimated_shares(self.mixed.posterior))

    def material(self, key: int) -> Mixture:
        """Return the distribution of a key's unknown; at its bound, as if that were none."""
        if key in self.mixed.free:
            return self.mixed.posterior.unknown(self.mixed.free.index(key))
        return self.mixed.unbounded.unknown(key)

    def levels_of(self, key: int) -> list[int]:
        """Return the numbers of the levels at which a key scatters."""
        if key not in self.mixed.free:
            return []
        place = self.mixed.free.index(key)
        return [i for i, v in enumerate(self.mixed.posterior.model.levels) if v.key == place]

    def size(self, level: int) -> SizePosterior:
        """Return the posterior of the size of a level's scatter."""
        return self.mixed.posterior.size(level, self.level)

    def interval(self, key: int, mixture: Mixture) -> tuple[float, float]:
        """Return the interval of a key's value, of what is known of its unknown."""
        low, high = mixture.interval(self.level)
        parameter = self.parameters[key]
        return parameter.value(low), parameter.value(high)

    def estimate(self, key: int) -> ParameterEstimate:
        """Return the estimate of the material's value of a key."""
        parameter, mixture, unknown = self.parameters[key], self.material(key), self.best_fit.x[key]
        value, mean = parameter.value(unknown), mixture.mean
        ends, one_sided = mixture.interval(self.level), mixture.quantile(self.level) - mean
        verdict, interval = judged(parameter, unknown, mean, mixture.sd, ends, one_sided)
        direction = f"these tests hardly determine {parameter.key} of the material"
        if parameter.key in self.confounded_with_drift:
            verdict, interval = "not identified", (None, None)
            direction = f"{parameter.key} against {self.confounded_with_drift[parameter.key]}"
        direction *= verdict == "not identified"
        natural = mixture.sd * parameter.slope(value)
        return ParameterEstimate(parameter.key, value, natural, interval, verdict, direction)

    def specimens_needed(self, key: int) -> int | None:
        """Return how many specimens tell the material's value to 10 %; None for no such number.

        Of a key whose logarithm is fitted, with scatter between specimens alone.
        """
        levels = self.levels_of(key)
        if [self._name(i) for i in levels] != ["specimen"] or not self.parameters[key].log:
            return None  # more specimens do not tell batches apart
        test_sd = float(np.median(self.alone_sd[:, key]))
        if not np.isfinite(test_sd):
            return None
        sd = np.hypot(self._median_size(levels[0]), test_sd)
        quantile = 0.5 + 0.5 * self.level
        if self.sizes[levels[0]].known is not None:
            return max(1, int(np.ceil((float(norm.ppf(quantile)) * sd / _WANTED) ** 2)))
        n = 2
        while float(student_t.ppf(quantile, n - 1)) * sd / np.sqrt(n) > _WANTED:
            n += 1
            if n > _MOST_SPECIMENS:
                return None
        return n

    def _name(self, level: int) -> str:
        return self.mixed.posterior.model.levels[level].name

    def _median_size(self, level: int) -> float:
        known = self.sizes[level].known
        return self.size(level).median if known is None else known

    def entry(self, key: int) -> dict[str, Any]:
        """Return the entries of a key in fit.json, beside its estimate."""
        if key not in self.mixed.free:
            return {}
        levels = self.levels_of(key)
        parts = ["scatter"] * bool(self.sizes) + ["process"] * bool(self.wear.shares)
        interval_of = f"{' and '.join(parts)} integrated"
        if not levels:
            return {"interval_of": interval_of}
        parameter, place = self.parameters[key], self.mixed.free.index(key)
        following = self.mixed.posterior.next_specimen(place)
        sizes = {self._name(i): self._median_size(i) for i in levels}
        entry: dict[str, Any] = {
            "of": "material",
            "interval_of": interval_of,
            "scatter": {self._name(i): self._size_entry(i) for i in levels},
            "next": list(self.interval(key, following)),
            "each": self._groups_entry(key, levels),
        }
        if parameter.log:
            variance = sum(size**2 for size in sizes.values())
            entry["mean"] = parameter.value(self.material(key).mean + 0.5 * variance)
        if "specimen" in sizes:
            entry["repeatability"] = {"s_r": sizes["specimen"], "r": _LIMIT * sizes["specimen"]}
        if len(sizes) > 1:
            total = float(np.sqrt(sum(size**2 for size in sizes.values())))
            entry["reproducibility"] = {"s_R": total, "R": _LIMIT * total}
        if (needed := self.specimens_needed(key)) is not None:
            entry["specimens_for_10_percent"] = needed
        return entry

    @property
    def warnings(self) -> tuple[ValidityWarning, ...]:
        """Warnings about scatters of which readings say next to nothing."""
        warnings = []
        if not self.converged:
            text = (
                "the iteration over values of specimens has not converged: numbers of the material "
                "are from its last round; fit fewer keys, or add priors"
            )
            warnings.append(ValidityWarning("scatter-not-converged", text))
        posterior = self.mixed.posterior
        unsettled = float(posterior.weights @ ~posterior.solutions.settled)
        if unsettled > _UNSETTLED:
            text = (
                "the iteration over readings that are limits has not converged for "
                f"{100.0 * unsettled:.2g} % of what is known of the sizes of scatters: numbers of "
                "the material are rough; check the limits farthest from the other readings"
            )
            warnings.append(ValidityWarning("limits-not-settled", text))
        for key, parameter in enumerate(self.parameters):
            for i in self.levels_of(key):
                count, plural = len(self.names[i]), PLURALS[self._name(i)]
                if self.sizes[i].known is None and count <= _FEW:
                    text = (
                        f"the scatter of {parameter.key} is from only {count} {plural}: the "
                        "intervals of the scatter and of the material depend mostly on the prior; "
                        f"3 or more {plural} are needed"
                    )
                    values = {"groups": count, "level": self._name(i)}
                    warnings.append(
                        ValidityWarning("few-specimens", text, (parameter.key,), (), values)
                    )
        if self.doubt_of_pieces:
            warnings.append(ValidityWarning("posterior-pieces", self.doubt_of_pieces))
        return (*warnings, *self._nonlinear_intervals(), *self.wear.warnings(self.process))

    def _nonlinear_intervals(self) -> Iterator[ValidityWarning]:
        """Yield a doubt for each key whose linear interval is off, by what is known in pieces."""
        if not self.pieces:
            return
        of_material, of_next = self._draws()
        tail = 0.5 * (1.0 - self.level)
        for place, key in enumerate(self.mixed.free):
            parameter, linear = self.parameters[key], self.material(key)
            ends = np.quantile(of_material[:, place], [tail, 1.0 - tail])
            off = (ends - linear.interval(self.level)) / linear.sd
            estimate = self.estimate(key)
            known = [limit is not None for limit in estimate.interval]
            if not (np.abs(off[known]) > _MOST_BENT).any():
                continue
            values: dict[str, Any] = {"off_sd": (-off).tolist()}
            values["low"], values["high"] = map(parameter.value, ends.tolist())
            unit, scale = parameter.unit or base_unit(parameter.key), unit_scale(parameter)
            unit = "" if unit in (None, "", "1", "-") else f" {unit}"
            words = f"from {values['low'] / scale:.4g} to {values['high'] / scale:.4g}{unit}"
            if self.levels_of(key):
                ends = np.quantile(of_next[:, place], [tail, 1.0 - tail])
                low, high = values["next"] = [*map(parameter.value, ends.tolist())]
                words += f", the next specimen from {low / scale:.4g} to {high / scale:.4g}{unit},"
            text = (
                f"{estimate.key}: {words} where histories are computed over all that is known, as "
                "predictions and running tests draw it; the interval, which is linear about the "
                f"estimate, is off by {-off[0]:+.2g} and {-off[1]:+.2g} sd at its ends"
            )
            yield ValidityWarning("nonlinear-interval", text, (estimate.key,), (), values)

    def _draws(self) -> tuple[FloatArray, FloatArray]:
        """Return unknowns (draws, free) of the material, and of its next specimen, by the pieces.

        All are within the bounds of all keys, as predictions draw them: what is beyond the bound
        of one key says nothing of the others.
        """
        posteriors = [piece.posterior for piece in self.pieces]
        means = np.concatenate([posterior.means_of() for posterior in posteriors])
        covariances = np.concatenate([posterior.covariances_of() for posterior in posteriors])
        weights = np.concatenate([p.weight * p.posterior.weights for p in self.pieces])
        random, normal = np.random.default_rng(0), (_DRAWS, len(self.mixed.free))
        part = random.choice(len(weights), _DRAWS, p=weights / weights.sum())
        roots = np.linalg.cholesky(covariances)[part]
        material = means[part] + np.einsum("dij,dj->di", roots, random.standard_normal(normal))
        following = material.copy()
        scatters = np.concatenate([posterior.solutions.tau for posterior in posteriors])[part]
        for level, sizes in zip(self.mixed.posterior.model.levels, scatters.T, strict=True):
            following[:, level.key] += sizes * random.standard_normal(_DRAWS)
        bounds = [
            [self.parameters[key].unknown(bound) for bound in self.parameters[key].bounds]
            for key in self.mixed.free
        ]
        low, high = np.array(bounds).T
        inside, next_inside = (
            ((drawn >= low) & (drawn <= high)).all(axis=1) for drawn in (material, following)
        )
        return material[inside], following[next_inside]

    def _size_entry(self, level: int) -> dict[str, Any]:
        groups = len(self.names[level])
        if (known := self.sizes[level].known) is not None:
            return {"known": known, "groups": groups}
        size = self.size(level)
        return {
            "estimate": size.median,
            "interval": list(size.interval),
            "reml": size.restricted,
            "verdict": "at bound" if size.at_bound else "identified",
            "groups": groups,
        }

    def _groups_entry(self, key: int, levels: Sequence[int]) -> dict[str, Any]:
        """Return each group of the level with the smallest groups: shrunk, and alone."""
        parameter, place = self.parameters[key], self.mixed.free.index(key)
        finest = max(levels, key=lambda i: len(self.names[i]))
        groups = self.mixed.posterior.model.levels[finest].group
        variance = sum(self._median_size(i) ** 2 for i in levels)
        entries = {}
        for number, name in enumerate(self.names[finest]):
            tests = np.flatnonzero(groups == number)
            shrunk = self.mixed.posterior.unknown(place, int(tests[0]))
            value = parameter.value(shrunk.mean)
            entries[name] = {
                "estimate": value,
                "sd": shrunk.sd * parameter.slope(value),
                "interval": list(self.interval(key, shrunk)),
                "alone": None,
                "shrinkage": 1.0,
            }
            tests = tests[np.isfinite(self.alone_sd[tests, key])]
            if len(tests):
                weight = 1.0 / self.alone_sd[tests, key] ** 2
                alone = parameter.value(float(weight @ self.alone[tests, key] / weight.sum()))
                alone_variance = float(1.0 / weight.sum())
                entries[name]["alone"] = {
                    "estimate": alone,
                    "sd": np.sqrt(alone_variance) * parameter.slope(alone),
                }
                entries[name]["shrinkage"] = alone_variance / (alone_variance + variance)
        return entries
