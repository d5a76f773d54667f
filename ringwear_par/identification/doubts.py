"""What was checked of a fit, and doubts about it: reasons not to trust its numbers as they are.

Checks are entries of fit.json. A doubt of a kind is one sentence, however many tests or series it
is about.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import ValidityWarning, counted
from ringwear_par.identification.definition.problem import PLURALS, Problem, body_of_wear
from ringwear_par.identification.fitted_tests import FittedSeries
from ringwear_par.identification.record_checks import trend
from ringwear_par.identification.solution import Solution

#: p-values below which a model does not fit, tests do not agree, and residuals are no noise
IMPROBABLE, _NO_CHANCE, _NO_NOISE = 1e-3, 0.01, 1e-4
#: share of the largest information of a test below which a test has none
_INFORMED = 1e-6
#: beginnings of keys of rates: other keys are settings of the machine
_RATES = ("wear.", "contact.friction")
#: groups up to which a scatter depends mostly on its prior
_FEW = 2
#: largest share of histories that fail
_FAILED = 0.05
#: doubts about series whose size is beyond a limit: minus a p-value, sd that a reading is off, and
#: minus time constants of growth; in the place of {} is the size of the worst one
_OF_SERIES = {
    "residuals-trend": (-_NO_NOISE, "readings trend away from the model (p = {}): they differ from "
                        "it by more than noise, and intervals are too narrow"),
    "outliers": (6.0, "up to {} sd off the model: check units, and the side of limits; exclude "
                 "leaves out an edge or a stop"),
    "drift-or-growth": (-3.0, "{} time constants hardly tell a drift from thermal growth; give one "
                        "a prior"),
}  # fmt: skip

Entries = Mapping[str, Mapping[str, Any]]
Check = dict[str, Any]


def check(name: str, value: float, must: Literal["<", ">"], limit: float) -> Check:
    """Return what fit.json has of a check."""
    passed = bool(value < limit if must == "<" else value > limit)
    known = value if np.isfinite(value) else None
    return {"name": name, "value": known, "must": must, "limit": limit, "pass": passed}


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


def of_fit(solution: Solution, goodness: Mapping[str, Any]) -> Iterator[Check | ValidityWarning]:
    """Yield what tells whether draws are the posterior's, and with a p-value whether they fit."""
    failed, histories = solution.failed, solution.histories
    share = failed / max(histories, 1)
    yield check("emulators: sd of the error of log p", solution.emulator_error, "<", 0.1)
    yield check("time steps halved: sd of the change of log p", solution.step_error, "<", 0.2)
    yield check("share of histories that failed", share, "<", _FAILED)
    yield check("effective number of draws", solution.effective, ">", 1000.0)
    if share >= _FAILED:
        text = f"{failed} of {histories} histories failed, and count as improbable"
        yield ValidityWarning("histories-failed", f"{text}: {solution.reason}")
    if (p := goodness["p_value"]) is not None:
        yield check("chi2: probability of one so large", p, ">", IMPROBABLE)
    if goodness["flagged"]:
        freedom = f"{goodness['degrees_of_freedom']:.4g} degrees of freedom (p = {p:.1g})"
        text = f"the model does not fit: chi2 = {goodness['chi2']:.4g} of {freedom}; the noise is "
        text += "larger than its sd, or the wear law is another"
        yield ValidityWarning("does-not-fit", text)


def of_series(every: Sequence[FittedSeries]) -> Iterator[Check | ValidityWarning]:
    """Yield what tells whether residuals are noise in time, single readings are like the others.

    Also a doubt about growth that may be drift.
    """
    found = defaultdict[str, list[tuple[float, str, str]]](list)
    for one in every:
        series, residuals = one.series, one.drawn.residuals
        if not series.profile and len(one.misfits):
            # noise that is given is no smaller than that
            least = 0.0 if series.sd_fitted else 1.0
            p = trend(one.misfits, len(series.nuisances), least)
            found["residuals-trend"].append((-p, one.title, one.test))
        holds = one.drawn.censored * residuals < 0.0  # of a limit
        far = np.where(holds, 0.0, np.abs(residuals))
        if not series.sd_fitted:
            axis, unit = ("r", "mm") if series.profile else ("time", "s")
            at = f" at {axis} = {series.x[far.argmax()]:.6g} {unit}" * (series.n > 1)
            found["outliers"].append((float(far.max()), one.title + at, one.test))
        flat = {n.kind for n in series.nuisances if n.prior is None}
        if (growth := series.growth_time) and {"drift", "thermal"} <= flat:
            lengths = float(series.x.max() / np.median(one.nuisances[growth.kind]))
            found["drift-or-growth"].append((-lengths, one.title, one.test))
    if trends := found["residuals-trend"]:
        name = "residuals in time: least probability that they are noise"
        yield check(name, -max(trends)[0], ">", _NO_NOISE)
    for code, (limit, sentence) in _OF_SERIES.items():
        if beyond := [one for one in found[code] if one[0] > limit]:
            (size, name, _), rest = max(beyond), len(beyond) - 1
            more = f" and {counted(rest, 'other')}" * bool(rest)
            text = f"{name}{more}: {sentence.format(f'{abs(size):.2g}')}"
            tests = tuple(dict.fromkeys(test for _, _, test in beyond))
            values = {name: abs(size) for size, name, _ in beyond}
            yield ValidityWarning(code, text, (), tests, values)


def of_tests(
    problem: Problem, entries: Entries, scores: FloatArray, information: FloatArray
) -> Iterator[Check | ValidityWarning]:
    """Yield what tells whether tests agree on the key of a rate on which they agree least.

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
        unit = f" {entries[key]['unit']}".removesuffix(" 1")
        times, unit = (100.0, " %") if parameter.log else (1.0, unit)
        text = (
            f"{key} scatters between tests of {of} conditions by {times * scatter:.2g}{unit} "
            f"(DerSimonian-Laird), but the readings explain only {times * own:.2g}{unit}: use "
            f'scatter = "fit"{more}'
        )
        values = {"q": q, "freedom": freedom, "scatter": scatter, "p": p, "readings": own}
        names = tuple(tests[i].name for i in informed)
        found.append((q, p, ValidityWarning("tests-disagree", text, (key,), names, values)))
    if found:  # a key that scatters makes the others look as if they did
        _, p, doubt = max(found, key=lambda one: one[0])
        yield check(f"tests agree on {doubt.keys[0]}: probability", p, ">", _NO_CHANCE)
        yield from [doubt] * (p <= _NO_CHANCE)


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
