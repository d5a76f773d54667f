"""What was checked of a fit, and doubts about it: reasons not to trust its numbers as they are.

A doubt of a kind is one sentence, however many tests or series it is about.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.schema import unit_of
from ringwear_par.errors import ValidityWarning, counted
from ringwear_par.identification.definition.problem import PLURALS, Problem, body_of_wear
from ringwear_par.identification.fitted_tests import FittedSeries
from ringwear_par.identification.record_checks import trend
from ringwear_par.identification.solution import Solution

#: sd above which readings do not belong to the others
_FAR = 6.0
#: p-values below which a model does not fit, tests do not agree, and residuals are no noise
IMPROBABLE, _NO_CHANCE, _NO_NOISE = 1e-3, 0.01, 1e-4
#: share of the largest information of a test below which a test has none
_INFORMED = 1e-6
#: beginnings of keys of rates: other keys are settings of the machine
_RATES = ("wear.", "contact.friction")
#: time constants of growth below which a record cannot distinguish growth from drift
_ALIKE = 3.0
#: groups up to which a scatter depends mostly on its prior
_FEW = 2
#: largest sd of the error of log p by emulators, and by time steps; fewest effective draws; largest
#: share of histories that fail
_EMULATED, _STEPPED, _EFFECTIVE, _FAILED = 0.1, 0.2, 1000.0, 0.05

Entries = Mapping[str, Mapping[str, Any]]
Doubt = ValidityWarning | None
Check = tuple[dict[str, Any], Doubt]


def check(
    name: str, value: float, must: Literal["<", ">"], limit: float, doubt: Doubt = None
) -> Check:
    """Return what fit.json has of a check, and a doubt where it is not passed.

    No doubt where the table of checks tells all.
    """
    passed = bool(value < limit if must == "<" else value > limit)
    known = value if np.isfinite(value) else None
    entry = {"name": name, "value": known, "must": must, "limit": limit, "pass": passed}
    return entry, None if passed else doubt


def of_computation(solution: Solution) -> list[Check]:
    """Return what tells whether draws are those of the posterior."""
    failed, settled = solution.failed / max(solution.histories, 1), np.isfinite(solution.step_error)
    lost = ValidityWarning(
        "histories-failed",
        f"{solution.failed} of {solution.histories} histories failed, and count as improbable: "
        f"{solution.reason}",
    )
    off = ValidityWarning(
        "not-settled",
        "draws still reach the ends of where emulators are known: intervals may be too narrow; "
        "narrower bounds or priors would help",
    )
    step = "time steps halved: sd of the change of log p"
    return [
        check("emulators: sd of the error of log p", solution.emulator_error, "<", _EMULATED),
        check(step, solution.step_error, "<", _STEPPED, None if settled else off),
        check("share of histories that failed", failed, "<", _FAILED, lost),
        check("effective number of draws", solution.effective, ">", _EFFECTIVE),
    ]


def of_squares(goodness: Mapping[str, Any]) -> list[Check]:
    """Return what tells whether the model fits all readings; nothing without a p-value."""
    if (p := goodness["p_value"]) is None:
        return []
    text = (
        f"the model does not fit: chi2 = {goodness['chi2']:.4g} of "
        f"{goodness['degrees_of_freedom']:.4g} degrees of freedom (p = {p:.1g}); the noise is "
        "larger than its sd, or the wear law is another"
    )
    doubt = ValidityWarning("does-not-fit", text)
    return [check("chi2: probability of one so large", p, ">", IMPROBABLE, doubt)]


def of_trends(every: Sequence[FittedSeries]) -> list[Check]:
    """Return what tells whether the residuals of records are noise in time."""
    found = []
    for one in every:
        if not one.series.profile and len(one.misfits):
            # noise that is given is no smaller than that
            least = 0.0 if one.series.sd_fitted else 1.0
            p = trend(one.misfits, len(one.series.nuisances), least)
            found.append((-p, one.title, one.test))
    if not found:
        return []
    text = (
        "readings trend away from the model (p = {}): they differ from it by more than noise, "
        "and intervals are too narrow"
    )
    doubt = _together("residuals-trend", [one for one in found if -one[0] < _NO_NOISE], text)
    name, least = "residuals in time: least probability that they are noise", -max(found)[0]
    return [check(name, least, ">", _NO_NOISE, *doubt)]


def of_tests(
    problem: Problem, entries: Entries, scores: FloatArray, information: FloatArray
) -> list[Check]:
    """Return what tells whether tests agree on the key of a rate on which they agree least.

    By ``scores_and_information`` of each, (tests, m).
    """
    tests, found = problem.experiments, []
    for parameter, score, a in zip(problem.parameters, scores.T, information.T, strict=True):
        key = parameter.key
        informed = np.flatnonzero(a > _INFORMED * max(a.max(), 1e-300)).tolist()
        free = parameter.scatter is None and entries[key]["verdict"] == "identified"
        if len(informed) < 2 or not free or not key.startswith(_RATES):
            continue
        score, a = score[informed], a[informed]
        _, equal = np.unique([tests[i].conditions for i in informed], return_inverse=True)
        of, more, spread = "equal", "", heterogeneity(score, a, equal)
        if spread[-1] >= _NO_CHANCE:
            of, more, spread = "different", ", or another law", heterogeneity(score, a, 0 * equal)
        q, freedom, scatter, p = spread
        own = float(np.median(a**-0.5))
        times, unit = (100.0, " %") if parameter.log else (1.0, f" {unit_of(key)}".rstrip())
        text = (
            f"{key} scatters between tests of {of} conditions by {times * scatter:.2g}{unit} "
            f"(DerSimonian-Laird), but the readings explain only {times * own:.2g}{unit}: use "
            f'scatter = "fit"{more}'
        )
        values = {"q": q, "freedom": freedom, "scatter": scatter, "p": p, "readings": own}
        names = tuple(tests[i].name for i in informed)
        doubt = ValidityWarning("tests-disagree", text, (key,), names, values)
        found.append((q, check(f"tests agree on {key}: probability", p, ">", _NO_CHANCE, doubt)))
    # one that scatters makes the others look as if they did
    return [one for _, one in sorted(found, key=lambda one: one[0])[-1:]]


def heterogeneity(
    score: FloatArray, information: FloatArray, group: IntArray
) -> tuple[float, int, float, float]:
    """Return Q, its freedom, the scatter of tests within groups, all (tests,), and Q's chance."""
    s, a, squares = (np.bincount(group, v) for v in (score, information, information**2))
    q, freedom = float((score**2 / information).sum() - (s**2 / a).sum()), len(score) - len(a)
    if not freedom:
        return q, 0, 0.0, 1.0
    scatter = math.sqrt(max(q - freedom, 0.0) / float((a - squares / a).sum()))
    return q, freedom, scatter, float(chi2.sf(q, freedom))


def _together(
    code: str, found: Sequence[tuple[float, str, str]], sentence: str
) -> list[ValidityWarning]:
    """Return one doubt about all that was found: how bad, what and in which test; none without.

    The sentence has the size of the worst one in place of {}.
    """
    if not found:
        return []
    (size, name, _), rest = max(found), len(found) - 1
    more = f" and {counted(rest, 'other')}" * bool(rest)
    tests = tuple(dict.fromkeys(test for _, _, test in found))
    values = {name: abs(size) for size, name, _ in found}
    text = f"{name}{more}: {sentence.replace('{}', f'{abs(size):.2g}')}"
    return [ValidityWarning(code, text, (), tests, values)]


def of_keys(entries: Entries) -> Iterator[ValidityWarning]:
    """Yield doubts about keys that are not identified, or only by the bound of another."""
    lost = defaultdict(list)
    for key, entry in entries.items():
        if entry["verdict"] == "not identified":
            lost[entry["direction"]].append(key)
    for words, keys in lost.items():
        text = f"{' and '.join(keys)} {'is' if len(keys) == 1 else 'are'} not identified: {words}"
        yield ValidityWarning("not-identified", text, tuple(keys))
    for key, entry in entries.items():
        for other in entry.get("conditional_on", ()):
            bound = entries[other]["bounds"][entries[other]["interval"][0] is not None]
            text = f"{key} is identified only by the bound {bound:g} of {other}"
            yield ValidityWarning("conditional-verdict", text, (key, other))


def of_sizes(entries: Entries, process: Entries) -> Iterator[ValidityWarning]:
    """Yield doubts about sizes of scatter and random wear."""
    for key, entry in entries.items():
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
    for key, entry in process.items():
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


def of_readings(every: Sequence[FittedSeries]) -> list[ValidityWarning]:
    """Return doubts about single readings, and about growth that may be drift."""
    outliers, alike = [], []
    for one in every:
        series, residuals = one.series, one.drawn.residuals
        holds = one.drawn.censored * residuals < 0.0  # of a limit
        far = np.where(holds, 0.0, np.abs(residuals))
        if far.max() > _FAR and not series.sd_fitted:
            axis, unit = ("r", "mm") if series.profile else ("time", "s")
            at = f" at {axis} = {series.x[far.argmax()]:.6g} {unit}" * (series.n > 1)
            outliers.append((float(far.max()), one.title + at, one.test))
        flat = {n.kind for n in series.nuisances if n.prior is None}
        if (growth := series.growth_time) and {"drift", "thermal"} <= flat:
            lengths = float(series.x.max() / np.median(one.nuisances[growth.kind]))
            if lengths < _ALIKE:
                alike.append((-lengths, one.title, one.test))
    far_off = (
        "up to {} sd off the model: check units, and the side of limits; exclude leaves out an "
        "edge or a stop"
    )
    drift = "{} time constants hardly tell a drift from thermal growth; give one a prior"
    return _together("outliers", outliers, far_off) + _together("drift-or-growth", alike, drift)
