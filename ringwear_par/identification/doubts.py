"""Doubts about a fit, and what was checked: reasons not to trust its numbers as they are.

A doubt of a kind is one sentence, however many tests or series it is about.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ValidityWarning, counted
from ringwear_par.files.smoothing import MOST_POINTS
from ringwear_par.identification.definition.fitted_parameters import unit_of_key
from ringwear_par.identification.definition.problem import Experiment, Series, body_of_wear
from ringwear_par.identification.definition.reading_kinds import READING_KINDS
from ringwear_par.identification.definition.scatter import PLURALS
from ringwear_par.identification.fitted_tests import FittedTest
from ringwear_par.identification.record_checks import Record, trend

if TYPE_CHECKING:
    from ringwear_par.identification.fit_result import FitResult

#: chi2 over the number of readings above which a series stands out, and fewest of them
_HIGH, _SEVERAL = 2.0, 5
#: sd above which readings do not belong to the others; the largest share of such readings
_FAR, _SHARE = 6.0, 0.1
#: correlation of two keys above which a bound of one is what the other is known by
_CONDITIONAL = 0.87
#: probabilities below which differences between tests, or blocks of residuals, are not by chance
_NO_CHANCE, _NO_NOISE = 0.01, 1e-4
#: share of the largest information of a test below which a test has none
_INFORMED = 1e-6
#: beginnings of keys of rates: other keys are settings of the machine
_RATES = ("wear.", "contact.friction")
#: share of an input: smaller noise is not searched for trends
_EXACT = 1e-3
#: time constants of growth below which a record cannot distinguish growth from drift
_ALIKE = 3.0
#: groups up to which a scatter depends mostly on its prior
_FEW = 2
#: largest sd of the error of log p by emulators, and by time steps; fewest effective draws; largest
#: share of histories that fail
_EMULATED, _STEPPED, _EFFECTIVE, _FAILED = 0.1, 0.2, 1000.0, 0.05


@dataclass(frozen=True)
class Check:
    """Something that was checked: a statistic and its limit."""

    name: str
    value: float
    limit: float
    #: whether the statistic must be less than its limit, else more
    below: bool

    @property
    def passed(self) -> bool:
        """Whether it is."""
        return self.value < self.limit if self.below else self.value > self.limit


def checks(fit: "FitResult") -> list[Check]:
    """Return what was checked of a fit, the computation first."""
    solution, trends = fit.solution, [p for _, _, p in _trends(fit)]
    found = [
        Check("emulators: sd of the error of log p", solution.emulator_error, _EMULATED, True),
        Check("time steps halved: sd of the change of log p", solution.step_error, _STEPPED, True),
        Check("effective number of draws", solution.effective, _EFFECTIVE, False),
        Check("share of histories that failed", solution.failed / max(solution.histories, 1),
              _FAILED, True),
    ]  # fmt: skip
    if fit.p_value is not None:
        found.append(Check("chi2: probability of one so large", fit.p_value, 1e-3, False))
    if trends:
        name = "residuals in time: least probability that they are noise"
        found.append(Check(name, min(trends), _NO_NOISE, False))
    if (disagreement := _disagreement(fit)) is not None:
        name = f"tests agree on {disagreement[0]}: probability"
        found.append(Check(name, disagreement[1].probability, _NO_CHANCE, False))
    return found


def doubts(fit: "FitResult") -> list[ValidityWarning]:
    """Return the doubts about a fit, those about its keys first."""
    found = (_of_keys, _of_the_model, _outliers, _of_records, _of_tests, _of_sizes, _of_draws)
    return [*(doubt for of in found for doubt in of(fit)), *assumptions(fit.problem.experiments)]


def _of_keys(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about keys that are not identified, or at a bound, and what depends on these."""
    for key, entry in fit.entries.items():
        if entry["verdict"] == "not identified":
            text = f"{key} is not identified: {entry['direction']}"
            yield ValidityWarning("not-identified", text, (key,))
        elif entry["verdict"] == "at bound":
            text = f"{key} is at its bound {bound_of(entry):g}: its interval has one limit only"
            yield ValidityWarning("at-bound", text, (key,))
    for key, other, correlation in conditions(fit):
        text = (
            f"{key} is identified only by the bound {bound_of(fit.entries[other]):g} of {other}: "
            f"they are correlated by {correlation:+.2f}"
        )
        values = {"correlation": correlation}
        yield ValidityWarning("conditional-verdict", text, (key, other), (), values)


def bound_of(entry: Mapping[str, Any]) -> float:
    """Return the bound at which a key is, by its entry in fit.json."""
    return float(entry["bounds"][0 if entry["interval"][0] is None else 1])


def conditions(fit: "FitResult") -> list[tuple[str, str, float]]:
    """Return keys that are identified by the bound of another key, that, and their correlation."""
    keys, table = [*fit.entries], fit.correlations
    return [
        (key, other, float(table[i, j]))
        for i, key in enumerate(keys)
        for j, other in enumerate(keys)
        if fit.entries[key]["verdict"] == "identified"
        and fit.entries[other]["verdict"] == "at bound"
        and abs(table[i, j]) > _CONDITIONAL
    ]


def _of_the_model(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about a model that does not fit, all readings or some."""
    if fit.flagged:
        text = (
            f"the model does not fit: chi2 = {fit.chi2:.4g} of {fit.freedom:.4g} degrees of "
            f"freedom (p = {fit.p_value:.1g}); the noise is larger than its sd, or the wear law is "
            "another"
        )
        yield ValidityWarning("does-not-fit", text)
        if fit.alternatives and all(other.flagged for other in fit.alternatives.values()):
            yield ValidityWarning("no-law-fits", "none of the laws compared fits either")
    bad = [
        (entry["chi2"] / entry["n"], f"{name} ({test})", test)
        for test, of_test in fit.experiments.items()
        for name, entry in of_test.items()
        if entry["n"] > _SEVERAL and entry["chi2"] > _HIGH * entry["n"] and "sd" not in entry
    ]
    if bad:
        worst, name, _ = max(bad)
        text = f"{_series(bad)} not fit: of {name}, chi2 is {worst:.3g} times the number of readings"
        values = {name: ratio for ratio, name, _ in bad}
        yield ValidityWarning("series-does-not-fit", text, (), _tests(bad), values)


def _series(found: Sequence[Any]) -> str:
    return f"{len(found)} series {'does' if len(found) == 1 else 'do'}"


def _tests(found: Sequence[tuple[Any, ...]]) -> tuple[str, ...]:
    """Return the names of tests, the last of each entry, each once."""
    return tuple(dict.fromkeys(str(entry[-1]) for entry in found))


def _outliers(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about readings that do not fit at all, and limits that do not hold."""
    few, broken = [], []
    for test in fit.tests:
        for series, part in test.records:
            far, limit = np.abs(test.residuals[part]), test.censored[part] != 0.0
            name = f"{series.name} ({test.experiment.name})"
            wrong = limit & (far > _FAR) & (test.censored[part] * test.residuals[part] > 0.0)
            if wrong.any():
                broken.append((far[wrong].max(), wrong.sum(), name, test.experiment.name))
            outside = ~limit & (far > _FAR)
            share = float(far[outside] @ far[outside] / max(far[~limit] @ far[~limit], 1e-300))
            if not series.sd_fitted and outside.any() and (
                outside.sum() <= max(1, _SHARE * series.n) or share > 0.5
            ):  # fmt: skip
                axis, unit = ("r", "mm") if series.profile else ("time", "s")
                place = f" at {axis} = {series.x[np.argmax(far * outside)]:.6g} {unit}"
                at = f"{name}{place * (series.n > 1)}"
                few.append((far[outside].max(), outside.sum(), at, test.experiment.name))
    if few:
        most, _, at, _ = max(few)
        text = (
            f"{counted(int(sum(entry[1] for entry in few)), 'reading')} of "
            f"{len(few)} series up to {most:.3g} sd off the model, the "
            f"furthest of {at}: check units; exclude leaves out what belongs to an edge or a stop"
        )
        values = {entry[2]: float(entry[0]) for entry in few}
        yield ValidityWarning("outliers", text, (), _tests(few), values)
    if broken:
        most, _, name, _ = max(broken)
        count = int(sum(entry[1] for entry in broken))
        text = (
            f"the model is on the wrong side of {counted(count, 'limit')}, by up to {most:.3g} sd "
            f"of {name}; check censored and the unit"
        )
        values = {entry[2]: float(entry[0]) for entry in broken}
        yield ValidityWarning("limits-broken", text, (), _tests(broken), values)


def _of_records(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about records: trends, signs, growth that may be drift, curves of inputs."""
    worn = [(p, f"{series.name} ({test.experiment.name})", test.experiment.name)
            for test, series, p in _trends(fit) if p < _NO_NOISE]  # fmt: skip
    if worn:
        p, name, _ = min(worn)
        text = (
            f"readings of {len(worn)} series trend away from the model, most "
            f"of all {name} (p = {p:.1g}): they differ from it by more than noise, and intervals "
            "are too narrow"
        )
        values = {series: probability for probability, series, _ in worn}
        yield ValidityWarning("residuals-trend", text, (), _tests(worn), values)
    yield from _oppositions(fit.tests)
    alike = [
        (series.x.max(), float(np.median(test.growth_times[number])), f"{series.name} ("
         f"{test.experiment.name})", test.experiment.name)
        for test in fit.tests for number, series in enumerate(test.experiment.series)
        if number in test.growth_times
        and {"drift", "thermal"} <= {n.kind for n in series.nuisances if n.prior is None}
        and series.x.max() < _ALIKE * np.median(test.growth_times[number])
    ]  # fmt: skip
    if alike:
        last, time, name, _ = alike[0]
        text = (
            f"{name}: readings until {last:.4g} s hardly tell a drift from thermal growth with a "
            f"time constant of {time:.3g} s{_more(alike)}; give one a prior"
        )
        yield ValidityWarning("drift-or-growth", text, (), _tests(alike))
    yield from input_trends(fit.problem.experiments)


def _more(found: Sequence[Any]) -> str:
    return f" (and {len(found) - 1} series more)" if len(found) > 1 else ""


def _trends(fit: "FitResult") -> list[tuple[FittedTest, Series, float]]:
    """Return tests, their records in time, and how probable their residuals are if noise."""
    found = []
    for test in fit.tests:
        for series, part in test.records:
            values = test.censored[part] == 0.0
            if not series.profile and values.any():
                # noise that is given is no smaller than that
                least = 0.0 if series.sd_fitted else 1.0
                p = trend(test.residuals[part][values], len(series.nuisances), least)
                found.append((test, series, p))
    return found


def _oppositions(tests: Sequence[FittedTest]) -> Iterator[ValidityWarning]:
    """Yield a doubt about records that fall where the model's, without nuisances, rise."""
    against = []
    for test in tests:
        for series, part in test.records:
            if READING_KINDS[series.kind].of_wear and not series.profile:
                record = Record(test.experiment, series, test.pure[part])
                if record.opposes():
                    name = f"{series.name} ({test.experiment.name})"
                    against.append((record.exclude, name, test.experiment.name))
    if not against:
        return
    exclude, name, _ = against[0]
    text = f"{name}: apart from nuisances, readings fall where the model rises{_more(against)}"
    if exclude is None:
        text += "; check their sign and the record of the test"
    else:
        span = f"{exclude[0]:.10g}, {exclude[1]:.10g}"
        text += (
            f", because of the readings from {exclude[0]:.10g} to {exclude[1]:.10g} s; if these "
            f"show something else than wear, leave them out: exclude = [[{span}]]"
        )
    values = {series: None if part is None else [*part] for part, series, _ in against}
    yield ValidityWarning("readings-oppose", text, (), _tests(against), values)


def input_trends(experiments: Sequence[Experiment]) -> list[ValidityWarning]:
    """Return a doubt about measured inputs whose curves do not follow their readings, or none."""
    found = []
    for experiment in experiments:
        for measured in experiment.inputs:
            time, value = measured.series.x, measured.readings(experiment.case)
            least = (_EXACT * float(value.mean())) ** 2
            p = trend(value - measured.curve(experiment.case)(time), least=least)
            if measured.smooth != "none" and p < _NO_NOISE:
                found.append((p, f"{measured.key} ({experiment.name})", experiment.name))
    if not found:
        return []
    p, name, _ = min(found)
    text = (
        f"readings of {counted(len(found), 'input')} trend away from their curve, most of all "
        f"{name} (p = {p:.1g}), which is too smooth for a jump or a fast change; smooth must be a "
        f'shorter time, or "none" (at most {MOST_POINTS} readings)'
    )
    values = {name: p for p, name, _ in found}
    return [ValidityWarning("input-trend", text, (), _tests(found), values)]


class Heterogeneity(NamedTuple):
    """Cochran's Q of a key, its degrees of freedom, and the scatter that explains it."""

    q: float
    freedom: int
    scatter: float

    @property
    def probability(self) -> float:
        """Probability of so large a Q where tests do not differ."""
        return float(chi2.sf(self.q, self.freedom)) if self.freedom else 1.0


def heterogeneity(
    score: FloatArray, information: FloatArray, groups: Sequence[Sequence[int]]
) -> Heterogeneity:
    """Return the heterogeneity within groups of tests, by scores and information (tests,)."""
    q, freedom, size = 0.0, 0, 0.0
    for tests in groups:
        if len(tests) < 2:
            continue
        s, a = score[list(tests)], information[list(tests)]
        q += float((s**2 / a).sum() - s.sum() ** 2 / a.sum())
        freedom += len(tests) - 1
        size += float(a.sum() - (a**2).sum() / a.sum())
    scatter = np.sqrt(max(q - freedom, 0.0) / size) if size > 0.0 else 0.0
    return Heterogeneity(q, freedom, float(scatter))


def _disagreement(fit: "FitResult") -> tuple[str, Heterogeneity, bool, float, tuple[str, ...]] | None:
    """Return the key of a rate that differs most between tests, and how much; None: none can.

    Also whether of tests of equal conditions, the sd by their own readings, and which tests.
    """
    problem, found = fit.problem, []
    score = np.array([squares.score[0] for squares in fit.squares])
    information = np.array([np.diag(squares.information[0]) for squares in fit.squares])
    conditions = defaultdict(list)
    for i, experiment in enumerate(problem.experiments):
        conditions[experiment.conditions].append(i)
    for j, (key, parameter) in enumerate(zip(problem.keys, problem.parameters, strict=True)):
        a = information[:, j]
        informed = np.flatnonzero(a > _INFORMED * max(a.max(), 1e-300)).tolist()
        free = parameter.scatter is None and fit.entries[key]["verdict"] == "identified"
        if len(informed) < 2 or not free or not key.startswith(_RATES):
            continue
        groups = [[i for i in tests if i in informed] for tests in conditions.values()]
        alike = heterogeneity(score[:, j], a, groups)
        equal = alike.probability < _NO_CHANCE
        worst = alike if equal else heterogeneity(score[:, j], a, [informed])
        names = tuple(problem.experiments[i].name for i in informed)
        found.append((key, worst, equal, float(np.median(a[informed] ** -0.5)), names))
    # one that scatters makes the others look as if they did
    return max(found, key=lambda entry: entry[1].q, default=None)


def _of_tests(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield a doubt about the key of a rate whose values differ most between tests."""
    if (found := _disagreement(fit)) is None or found[1].probability >= _NO_CHANCE:
        return
    key, worst, equal, own_sd, names = found
    log = fit.problem.parameters[fit.problem.keys.index(key)].log
    unit = "" if log else unit_of_key(fit.problem, key)

    def size(value: float) -> str:
        return f"{100.0 * value:.2g} %" if log else f"{value:.2g}{unit}"

    text = (
        f"{key} scatters between tests of {'equal' if equal else 'different'} conditions by "
        f"{size(worst.scatter)} (DerSimonian-Laird), but the readings explain only "
        f'{size(own_sd)}: use scatter = "fit"{"" if equal else ", or another law"}'
    )
    values = {**worst._asdict(), "p": worst.probability, "readings": own_sd}
    yield ValidityWarning("tests-disagree", text, (key,), names, values)


def _of_sizes(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about sizes of scatter and random wear."""
    for key, entry in fit.entries.items():
        for level, scatter in entry.get("scatter", {}).items():
            if "known" in scatter or scatter["groups"] > _FEW:
                continue
            plural = PLURALS[level]
            text = (
                f"the scatter of {key} is from only {scatter['groups']} {plural}: the intervals of "
                "the scatter and of the material depend mostly on the prior; 3 or more "
                f"{plural} are needed"
            )
            values = {"groups": scatter["groups"], "level": level}
            yield ValidityWarning("few-specimens", text, (key,), (), values)
    for key, entry in fit.process.items():
        body = body_of_wear(key)
        if entry["verdict"] != "identified":
            text = f"wear of {body}: intervals hold what was assumed of wear's own noise before"
            yield ValidityWarning("process-from-prior", text, (key,))
        if coarse_wear(fit, key):
            size = entry["size"].get("estimate", entry["size"].get("known"))
            text = (
                f"wear of {body} comes in events of {1e6 * size:.3g} nm, more than is worn between "
                "two readings: intervals of their size are not right"
            )
            yield ValidityWarning("coarse-wear", text, (key,))


def coarse_wear(fit: "FitResult", key: str) -> bool:
    """Tell whether events of random wear are larger than what is worn between two readings."""
    body, size = [*fit.process].index(key), fit.process[key]["size"]
    steps = [
        np.diff(np.unique(test.depths[part, body]))
        for test in fit.tests
        for series, part in test.records
        if series.n > _SEVERAL and not series.profile
    ]
    between = float(np.median(np.concatenate(steps))) if steps else np.inf
    return float(size.get("estimate", size.get("known"))) > between


def _of_draws(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about draws that are not those of the posterior."""
    if fit.solution.weighed:
        yield ValidityWarning("weighed", fit.solution.weighed)
    if _STEPPED <= fit.solution.step_error < np.inf:
        text = f"time steps half as long would change log p by {fit.solution.step_error:.2g} (sd)"
        yield ValidityWarning("step-dependent", text)
    if fit.solution.failed > _FAILED * fit.solution.histories:
        text = (
            f"{fit.solution.failed} of {fit.solution.histories} histories failed, and count as "
            f"improbable: {fit.solution.reason}"
        )
        yield ValidityWarning("histories-failed", text)


def assumptions(experiments: Sequence[Experiment]) -> list[ValidityWarning]:
    """Return the doubts about units that no name has, or that are likely wrong, one a sentence."""
    found: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for test in experiments:
        for series in [*test.series, *(entry.series for entry in test.inputs)]:
            for sentence in series.assumptions + series.suspicions:
                found[sentence].append((series.name, test.name))
    return [
        ValidityWarning(
            "assumed-unit", f"{of[0][0]} ({of[0][1]}): {sentence}{_more(of)}", (), _tests(of)
        )
        for sentence, of in found.items()
    ]
