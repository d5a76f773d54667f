"""Doubts about a fit, and what was checked: reasons not to trust its numbers as they are.

A doubt of a kind is one sentence, however many tests or series it is about.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ValidityWarning, counted
from ringwear_par.files.smoothing import MOST_POINTS
from ringwear_par.identification.definition.fitted_parameters import unit_of_key
from ringwear_par.identification.definition.problem import Experiment, body_of_wear
from ringwear_par.identification.definition.scatter import PLURALS
from ringwear_par.identification.record_checks import trend

if TYPE_CHECKING:
    from ringwear_par.identification.fit_result import FitResult

#: sd above which readings do not belong to the others; the largest share of such readings
_FAR, _SHARE = 6.0, 0.1
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


class Finding(NamedTuple):
    """Something about a series: how bad it is, what it is called, and its test."""

    size: float
    name: str
    test: str


def checks(fit: "FitResult") -> list[dict[str, Any]]:
    """Return what was checked of a fit, the computation first, as fit.json has it."""
    solution, trends, apart = fit.solution, _trends(fit), _disagreement(fit)
    less = [
        ("emulators: sd of the error of log p", solution.emulator_error, _EMULATED),
        ("time steps halved: sd of the change of log p", solution.step_error, _STEPPED),
        ("share of histories that failed", solution.failed / max(solution.histories, 1), _FAILED),
    ]
    more = [("effective number of draws", solution.effective, _EFFECTIVE)]
    if fit.p_value is not None:
        more.append(("chi2: probability of one so large", fit.p_value, 1e-3))
    if trends:
        name = "residuals in time: least probability that they are noise"
        more.append((name, -max(trends).size, _NO_NOISE))
    if apart is not None:
        name = f"tests agree on {apart.keys[0]}: probability"
        more.append((name, apart.values["p"], _NO_CHANCE))
    return [
        {
            "name": name,
            "value": value if np.isfinite(value) else None,
            "limit": limit,
            "pass": bool(sign * value < sign * limit),
        }
        for sign, found in ((1.0, less), (-1.0, more))
        for name, value, limit in found
    ]


def doubts(fit: "FitResult") -> list[ValidityWarning]:
    """Return the doubts about a fit, those about its keys first."""
    found = [*_of_keys(fit), *_of_the_model(fit), *_of_records(fit)]
    if (apart := _disagreement(fit)) is not None and apart.values["p"] < _NO_CHANCE:
        found.append(apart)
    found += [*_of_sizes(fit), *_of_draws(fit)]
    return [*found, *assumptions(fit.problem.experiments)]


def _merged(code: str, found: Sequence[Finding], sentence: str) -> Iterator[ValidityWarning]:
    """Yield one doubt about all findings, by a sentence with the size of the worst one."""
    if found:
        worst, rest = max(found), len(found) - 1
        more = f" and {counted(rest, 'other')}" * bool(rest)
        tests = tuple(dict.fromkeys(finding.test for finding in found))
        values = {finding.name: abs(finding.size) for finding in found}
        text = f"{worst.name}{more}: {sentence.format(abs(worst.size))}"
        yield ValidityWarning(code, text, (), tests, values)


def _of_keys(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about keys that are not identified, or only by the bound of another."""
    entries = fit.entries
    lost = [key for key, entry in entries.items() if entry["verdict"] == "not identified"]
    for words in dict.fromkeys(entries[key]["direction"] for key in lost):
        keys = tuple(key for key in lost if entries[key]["direction"] == words)
        text = f"{' and '.join(keys)} {'is' if len(keys) == 1 else 'are'} not identified: {words}"
        yield ValidityWarning("not-identified", text, keys)
    for key, entry in entries.items():
        for other in entry.get("conditional_on", ()):
            bound = entries[other]["bounds"][entries[other]["interval"][0] is not None]
            text = f"{key} is identified only by the bound {bound:g} of {other}"
            yield ValidityWarning("conditional-verdict", text, (key, other))


def _of_the_model(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about a model that does not fit, all readings or some."""
    if fit.flagged:
        text = (
            f"the model does not fit: chi2 = {fit.chi2:.4g} of {fit.freedom:.4g} degrees of "
            f"freedom (p = {fit.p_value:.1g}); the noise is larger than its sd, or the wear law is "
            "another"
        )
        yield ValidityWarning("does-not-fit", text)
    found = []
    for test in fit.tests:
        for series, part in test.records:
            side, far = test.censored[part], np.abs(test.residuals[part])
            far[side * test.residuals[part] < 0.0] = 0.0  # limits that hold
            outside = far > _FAR
            share = float(far[outside] @ far[outside] / max(far @ far, 1e-300))
            rare = outside.sum() <= max(1, _SHARE * series.n) or share > 0.5
            if outside.any() and rare and not series.sd_fitted:
                axis, unit = ("r", "mm") if series.profile else ("time", "s")
                at = f" at {axis} = {series.x[far.argmax()]:.6g} {unit}" * (series.n > 1)
                name = f"{series.name} ({test.experiment.name}){at}"
                found.append(Finding(float(far.max()), name, test.experiment.name))
    text = (
        "up to {:.3g} sd off the model: check units, and the side of limits; exclude leaves out an "
        "edge or a stop"
    )
    yield from _merged("outliers", found, text)


def _of_records(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about records: trends, growth that may be drift, curves of inputs."""
    text = (
        "readings trend away from the model (p = {:.1g}): they differ from it by more than noise, "
        "and intervals are too narrow"
    )
    yield from _merged("residuals-trend", [f for f in _trends(fit) if -f.size < _NO_NOISE], text)
    alike = []
    for test in fit.tests:
        for number, time in test.growth_times.items():
            series = test.experiment.series[number]
            lengths = float(series.x.max() / np.median(time))
            flat = {n.kind for n in series.nuisances if n.prior is None}
            if {"drift", "thermal"} <= flat and lengths < _ALIKE:
                name = f"{series.name} ({test.experiment.name})"
                alike.append(Finding(-lengths, name, test.experiment.name))
    text = "{:.2g} time constants hardly tell a drift from thermal growth; give one a prior"
    yield from _merged("drift-or-growth", alike, text)
    yield from input_trends(fit.problem.experiments)


def _trends(fit: "FitResult") -> list[Finding]:
    """Return how probable, times -1, the residuals of records in time are if they are noise."""
    found = []
    for test in fit.tests:
        for series, part in test.records:
            values = test.censored[part] == 0.0
            if not series.profile and values.any():
                # noise that is given is no smaller than that
                least = 0.0 if series.sd_fitted else 1.0
                p = trend(test.residuals[part][values], len(series.nuisances), least)
                name = f"{series.name} ({test.experiment.name})"
                found.append(Finding(-p, name, test.experiment.name))
    return found


def input_trends(experiments: Sequence[Experiment]) -> list[ValidityWarning]:
    """Return a doubt about measured inputs whose curves do not follow their readings, or none."""
    found = []
    for experiment in experiments:
        for measured in experiment.inputs:
            time, value = measured.series.x, measured.readings(experiment.case)
            least = (_EXACT * float(value.mean())) ** 2
            p = trend(value - measured.curve(experiment.case)(time), least=least)
            if measured.smooth != "none" and p < _NO_NOISE:
                name = f"{measured.key} ({experiment.name})"
                found.append(Finding(-p, name, experiment.name))
    text = (
        "readings trend away from their curve (p = {:.1g}), which is too smooth for a jump or a "
        f'fast change; smooth must be a shorter time, or "none" (at most {MOST_POINTS} readings)'
    )
    return [*_merged("input-trend", found, text)]


def heterogeneity(
    score: FloatArray, information: FloatArray, groups: Sequence[Sequence[int]]
) -> tuple[float, int, float]:
    """Return Q, its freedom and the scatter within groups of tests, by scores (tests,)."""
    q, freedom, size = 0.0, 0, 0.0
    for tests in groups:
        if len(tests) > 1:
            s, a = score[[*tests]], information[[*tests]]
            q += float((s**2 / a).sum() - s.sum() ** 2 / a.sum())
            freedom += len(tests) - 1
            size += float(a.sum() - (a**2).sum() / a.sum())
    scatter = np.sqrt(max(q - freedom, 0.0) / size) if size > 0.0 else 0.0
    return q, freedom, float(scatter)


def _disagreement(fit: "FitResult") -> ValidityWarning | None:
    """Return the doubt about the key of a rate that differs most between tests; None: none can.

    Its value p is how probable such differences are by chance.
    """
    tests, found = fit.problem.experiments, []
    for j, parameter in enumerate(fit.problem.parameters):
        key, (score, a) = parameter.key, fit.information[:, :, j]
        informed = np.flatnonzero(a > _INFORMED * max(a.max(), 1e-300)).tolist()
        free = parameter.scatter is None and fit.entries[key]["verdict"] == "identified"
        if len(informed) < 2 or not free or not key.startswith(_RATES):
            continue
        equal_tests = defaultdict(list)
        for i in informed:
            equal_tests[tests[i].conditions].append(i)
        of, more = "equal", ""
        q, freedom, scatter = heterogeneity(score, a, [*equal_tests.values()])
        if not freedom or chi2.sf(q, freedom) >= _NO_CHANCE:
            of, more = "different", ", or another law"
            q, freedom, scatter = heterogeneity(score, a, [informed])
        own = float(np.median(a[informed] ** -0.5))
        unit = "" if parameter.log else unit_of_key(fit.problem, key)
        sizes = [f"{100 * v:.2g} %" if parameter.log else f"{v:.2g}{unit}" for v in (scatter, own)]
        text = (
            f"{key} scatters between tests of {of} conditions by {sizes[0]} (DerSimonian-Laird), "
            f'but the readings explain only {sizes[1]}: use scatter = "fit"{more}'
        )
        values = {"q": q, "freedom": freedom, "scatter": scatter,
                  "p": float(chi2.sf(q, freedom)), "readings": own}  # fmt: skip
        names = tuple(tests[i].name for i in informed)
        found.append(ValidityWarning("tests-disagree", text, (key,), names, values))
    # one that scatters makes the others look as if they did
    return max(found, key=lambda doubt: doubt.values["q"], default=None)


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
        size, between = entry["size"], entry["between_readings"]
        events = size.get("estimate", size.get("known"))
        if between is not None and events > between:
            text = (
                f"wear of {body} comes in events of {1e6 * events:.3g} nm, more than is worn "
                "between two readings: intervals of their size are not right"
            )
            yield ValidityWarning("coarse-wear", text, (key,))


def _of_draws(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about draws that are not those of the posterior."""
    solution = fit.solution
    if not np.isfinite(solution.step_error):
        text = (
            "draws still reach the ends of where emulators are known: intervals may be too narrow; "
            "narrower bounds or priors would help"
        )
        yield ValidityWarning("not-settled", text)
    elif solution.step_error >= _STEPPED:
        text = f"time steps half as long would change log p by {solution.step_error:.2g} (sd)"
        yield ValidityWarning("step-dependent", text)
    if solution.failed > _FAILED * solution.histories:
        text = (
            f"{solution.failed} of {solution.histories} histories failed, and count as "
            f"improbable: {solution.reason}"
        )
        yield ValidityWarning("histories-failed", text)


def assumptions(experiments: Sequence[Experiment]) -> list[ValidityWarning]:
    """Return the doubts about units that no name has, or that are likely wrong, one a sentence."""
    found: dict[str, list[Finding]] = defaultdict(list)
    for test in experiments:
        for series in [*test.series, *(entry.series for entry in test.inputs)]:
            for sentence in series.assumptions + series.suspicions:
                found[sentence].append(Finding(0.0, f"{series.name} ({test.name})", test.name))
    escaped = {text.replace("{", "{{").replace("}", "}}"): of for text, of in found.items()}
    return [d for text, of in escaped.items() for d in _merged("assumed-unit", of, text)]
