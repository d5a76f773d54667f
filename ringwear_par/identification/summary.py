"""The numbers of a fit as people read them: rows and sentences, and the summary made of them.

The page of a fit is made of the same rows. An ``outcome`` is the contents of fit.json
(``FitResult.to_dict``), an ``entry`` those of a key.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.cases.units import CUSTOMARY
from ringwear_par.errors import counted, warning_lines
from ringwear_par.identification.definition.problem import body_of_wear
from ringwear_par.identification.definition.scatter import PLURALS

if TYPE_CHECKING:
    from ringwear_par.identification.fit_result import FitResult

Entry = Mapping[str, Any]
Interval = Sequence[float | None]

#: units of nuisances, after that of their readings
_PER = {"compliance": "/kN", "tilt": "/mm"}
#: headers of tables; cells are "" where there is nothing
SERIES = ("series", "readings", "chi2", "unit", "fitted noise", "nuisances")
LAWS = (
    "law", "AIC above the smallest", "BIC", "chi2", "probability", "parameters", "verdict",
)  # fmt: skip
#: digits of numbers: draws know no more
_DIGITS = 3


@dataclass(frozen=True)
class KeyRow:
    """A number of a fitted key, in the unit that its user writes."""

    #: the key, or what the number is where it is another one
    label: str
    #: None where it is at a bound, and the interval tells more
    estimate: float | None
    sd: float
    unit: str
    #: its ends, None where there is no limit
    interval: Interval
    #: verdict on the key, "" of a number that has none
    verdict: str = ""
    #: a remark on the number
    note: str = ""

    @property
    def digits(self) -> int:
        """How many digits its numbers have."""
        return digits_of(0.0 if self.estimate is None else self.estimate, self.interval)

    @property
    def value(self) -> str:
        """The estimate with its unit, or the limit."""
        if self.estimate is None:
            return f"{limits(self.interval)} {self.unit}".rstrip()
        return f"{number(self.estimate, self.digits)} {self.unit}".rstrip()

    @property
    def ends(self) -> str:
        """The interval in words, "" where it is told as the value."""
        return "" if self.estimate is None else limits(self.interval, self.digits)


def digits_of(estimate: float, interval: Interval) -> int:
    """Return how many digits a number and its interval are told with: no more than draws know."""
    low, high = interval
    if low is None or high is None or low == high:
        return _DIGITS
    ratio = max(abs(estimate), abs(low), abs(high)) / (high - low)
    return max(_DIGITS, 2 + int(np.log10(ratio)))


def number(value: float, digits: int = _DIGITS) -> str:
    """Return a number with some significant digits, without an exponent up to a million."""
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e" in text and 1e3 <= abs(value) < 1e6 else text


def limits(interval: Interval, digits: int = _DIGITS) -> str:
    """Return an interval in words."""
    low, high = (None if end is None else number(end, digits) for end in interval)
    if low is not None and high is not None:
        return f"from {low} to {high}"
    if low is None and high is None:
        return "no limit within its bounds"
    return f"more than {low}" if high is None else f"less than {high}"


def users_numbers(entry: Entry) -> tuple[Entry, str]:
    """Return the numbers of a key in the unit that its user writes, or the case's, and that."""
    numbers = entry.get("told") or {**entry, "scale": 1.0}
    unit = "" if numbers["unit"] in ("1", "-") else str(numbers["unit"])
    return numbers, f"{unit} per {numbers['per']}" if "per" in numbers else unit


def key_rows(key: str, entry: Entry) -> list[KeyRow]:
    """Return the rows of a fitted key: its estimate, and the specific wear rate that this means."""
    in_unit, unit = users_numbers(entry)
    verdict = entry["verdict"]
    estimate = None if verdict == "at bound" else in_unit["estimate"]
    rows = [KeyRow(key, estimate, in_unit["sd"], unit, in_unit["interval"], verdict)]
    rate = entry.get("specific_wear_rate")
    if rate is not None and verdict != "not identified":
        product = f"k mu at mu = {rate['mu']:.{_DIGITS}g}" if "mu" in rate else "k"
        note = f"{product}; {rate[CUSTOMARY]:.{_DIGITS}g} {CUSTOMARY}"
        label, limits_of_rate = "specific wear rate", rate["interval"]
        rows.append(
            KeyRow(label, rate["estimate"], rate["sd"], rate["unit"], limits_of_rate, note=note)
        )
    return rows


def series_rows(outcome: Entry) -> list[tuple[str, ...]]:
    """Return the cells of the series of all experiments, see ``SERIES``, limits in the notes."""
    rows: list[tuple[str, ...]] = []
    for experiment, series in outcome["experiments"].items():
        fitted = outcome["nuisance"].get(experiment, {})
        for name, entry in series.items():
            unit, limits_read = entry["unit"], entry.get("censored", 0)
            notes = [counted(limits_read, "limit")] if limits_read else []
            notes += [
                _nuisance(kind, nuisance, f"{unit}{_PER.get(kind, '')}")
                for kind, nuisance in fitted.get(name, {}).items()
            ]
            noise = f"{entry['sd']:.3g}" if "sd" in entry else ""
            squares = "" if limits_read == entry["n"] else f"{entry['chi2']:.4g}"
            rows.append(
                (f"{experiment}, {name}", str(entry["n"] - limits_read), squares, unit, noise,
                 ", ".join(notes))
            )  # fmt: skip
    return rows


def input_lines(outcome: Entry) -> list[str]:
    """Return a sentence about each measured input."""
    lines = []
    for experiment, inputs in outcome.get("inputs", {}).items():
        for key, entry in inputs.items():
            values = entry["value"]
            unit = "" if entry["unit"] == "1" else f" {entry['unit']}"
            text = (
                f"{experiment}, {key} as measured: {counted(entry['n'], 'reading')}, a curve from "
                f"{min(values):.4g} to {max(values):.4g}{unit}, readings scatter by "
                f"{100.0 * entry['scatter']:.2g} % about it"
            )
            if (scale := entry.get("scale")) is not None:
                text += f", scale {_with_sd(scale['estimate'], scale['sd'], 4, '')}"
            lines.append(text)
    return lines


def law_rows(outcome: Entry) -> list[tuple[str, ...]]:
    """Return the cells of the laws compared, the best by AIC first, those that failed last."""
    laws = {"this law": outcome, **outcome["alternatives"]}
    solved = {name: law for name, law in laws.items() if "aic" in law}
    best = min(law["aic"] for law in solved.values())
    shares = probabilities({name: law["log_evidence"] for name, law in solved.items()})
    rows: list[tuple[str, ...]] = []
    for name, law in sorted(solved.items(), key=lambda item: item[1]["aic"]):
        parameters = ", ".join(_estimate_text(k, p) for k, p in law["parameters"].items())
        verdict = "does not fit" if law["flagged"] else "fits"
        if law["p_value"] is None:
            verdict = "not tested: noise was fitted, has long tails, or readings are limits"
        numbers = f"{law['aic'] - best:+.1f}", f"{law['bic']:.1f}", f"{law['chi2']:.4g}"
        share = f"{shares[name]:.2g}" if shares.get(name, 0.0) >= 1e-4 else "< 1e-4"
        rows.append((name, *numbers, share, parameters, verdict))
    failed = ((name, law["error"]) for name, law in laws.items() if name not in solved)
    return [*rows, *((name, "", "", "", "", "", f"failed: {error}") for name, error in failed)]


def goodness(outcome: Entry) -> str:
    """Return chi2, degrees of freedom, p-value and information criteria in a sentence."""
    p_value = outcome["p_value"]
    entries = [entry for series in outcome["experiments"].values() for entry in series.values()]
    criteria = f"AIC {outcome['aic']:.1f}, BIC {outcome['bic']:.1f}"
    if all(entry.get("censored") == entry["n"] for entry in entries):
        return f"all readings are limits, which have no chi2; {criteria}"
    noise_fitted = any("sd" in entry for entry in entries)
    if p_value is not None:
        test = f"p = {p_value:.2g}" + " for the readings with a given sd" * noise_fitted
    elif noise_fitted:
        test = "no p-value, as all noise was fitted"
    else:
        test = 'loss "student"' if outcome["loss"] == "student" else "no p-value"
    n_limits = sum(entry.get("censored", 0) for entry in entries)
    of = counted(outcome["n_data"] - n_limits, "reading")
    of += f" and {counted(n_limits, 'limit')}" * bool(n_limits)
    return (
        f"chi2 = {outcome['chi2']:.4g} of {of}, "
        f"{outcome['degrees_of_freedom']:.4g} degrees of freedom ({test}); {criteria}"
    )


def _nuisance(kind: str, entry: Entry, unit: str) -> str:
    if entry["sd"] is None:
        return f"{kind} not identified"
    words = f"{kind} {_with_sd(entry['estimate'], entry['sd'], 3, f' {unit}')}"
    words += " at the largest friction power" * ("power" in entry)
    return f"{words} in {_nuisance('time', entry['time'], 's')}" if "time" in entry else words


def _estimate_text(key: str, entry: Entry) -> str:
    row = key_rows(key, entry)[0]
    known = f" (u = {row.sd:.2g})" * (row.verdict == "identified")
    return f"{key} {row.value}" if row.estimate is None else f"{key} = {row.value}{known}"


def _with_sd(value: float, sd: float | None, digits: int, unit: str) -> str:
    return f"{value:.{digits}g}{unit}" + ("" if sd is None else f" (u = {sd:.2g})")


def of_specimens(outcome: Entry) -> str:
    """Return the sentence that says what intervals without scatter are of."""
    count = outcome["specimens"]
    specimens = "this specimen" if count == 1 else f"these {count} specimens"
    return (
        f"of {specimens} only: repeats of a material scatter more "
        '(with repeats, use scatter = "fit")'
    )


def scatter_lines(estimate: Mapping[str, Any], level: float) -> list[str]:
    """Return sentences about the scatter of a key, none without; ``estimate`` as in fit.json."""
    if estimate["of"] != "material":
        return []
    log, (in_unit, _) = "mean" in estimate, users_numbers(estimate)
    unit = "" if in_unit["unit"] in ("1", "-") else f" {in_unit['unit']}"

    def size(value: float) -> str:
        return f"{100.0 * value:.2g}" if log else f"{value / in_unit['scale']:.3g}"

    unit_of_size = " %" if log else unit
    sizes = []
    for group, scatter in estimate["scatter"].items():
        count = scatter["groups"]
        between = f"between {count} {PLURALS[group] if count > 1 else group} "
        if "known" in scatter:
            sizes.append(f"{between}{size(scatter['known'])}{unit_of_size} (taken as known)")
            continue
        low, high = scatter["interval"]
        at_bound = ", perhaps none" * (scatter["verdict"] == "at bound")
        at_bound += ", mostly by its prior" * (scatter["verdict"] == "not identified")
        sizes.append(
            f"{between}{size(scatter['estimate'])}{unit_of_size} ({size(low)} to "
            f"{size(high)}{unit_of_size}{at_bound})"
        )
    digits = digits_of(in_unit["estimate"], in_unit["next"])
    lines = ["; ".join(sizes), f"the next specimen: {limits(in_unit['next'], digits)}{unit}"]
    comparisons = [
        f"{name} {symbol} = {size(estimate[name][symbol])}{unit_of_size}"
        for name, symbol in (("repeatability", "r"), ("reproducibility", "R"))
        if name in estimate
    ]
    if comparisons:
        lines[-1] += f" ({100.0 * level:g} %); {', '.join(comparisons)}"
    if (needed := estimate.get("specimens_for_10_percent")) is not None:
        lines.append(
            f"an interval of +-10 % for the material needs about {counted(needed, 'specimen')}"
        )
    return lines


def process_lines(outcome: Entry) -> list[str]:
    """Return a sentence about each body whose wear is itself random, and what follows of it."""
    lines = []
    for key, entry in outcome.get("process", {}).items():
        size, share = entry["size"], entry["share"]
        known = "known" in share
        sd = share["known" if known else "estimate"]
        events = size["known" if known else "estimate"]
        text = (
            f"wear of {body_of_wear(key)} fluctuates: sd {100.0 * sd:.2g} % of the "
            f"{1e3 * entry['depth']:.3g} um worn at the end"
        )
        if None not in (ends := share.get("interval", [None])):
            low, high = (100.0 * end for end in ends)
            text += f" ({100.0 * outcome['level']:g} %: {low:.2g} to {high:.2g} %)"
        text += f"; events of {1e6 * events:.3g} nm"
        if None not in (ends := size.get("interval", [None])):
            low, high = (1e6 * end for end in ends)
            text += f" ({low:.3g} to {high:.3g} nm)"
        lines.append(f"{text} (taken as known)" if known else f"{text}  {entry['verdict']}")
    scatters = [
        scatter
        for estimate in outcome["parameters"].values()
        for scatter in estimate.get("scatter", {}).values()
    ]
    if lines and any(scatter.get("verdict") == "at bound" for scatter in scatters):
        lines.append(
            "beside it, the specimens may not differ at all: with 3 specimens or more, scatter "
            "alone is enough for values of the material"
        )
    return lines


def probabilities(evidences: Mapping[str, float | None]) -> dict[str, float]:
    """Return the probability of each law whose evidence is known, as if all were equal before."""
    known = {name: value for name, value in evidences.items() if value is not None}
    if not np.isfinite(max(known.values(), default=-np.inf)):
        return {}
    shares = np.exp(np.array([*known.values()]) - max(known.values()))
    return dict(zip(known, (shares / shares.sum()).tolist(), strict=True))


def check_rows(outcome: Entry) -> list[tuple[str, str, str, str]]:
    """Return name, statistic, limit and outcome of all that was checked."""
    rows = []
    for check in outcome["checks"]:
        value = check["value"]
        # probabilities and counts must be more
        below = value is None or (value < check["limit"]) == check["pass"]
        told = "-" if value is None else f"{value:.0f}" if value > 100.0 else f"{value:.2g}"
        sign = "<" if below else ">"
        rows.append(
            (check["name"], told, f"{sign} {check['limit']:g}", "pass" if check["pass"] else "FAIL")
        )
    return rows


def summary(fit: "FitResult") -> str:
    """Return the outcome on one screen: the keys, whether the law fits, what was checked."""
    problem, outcome = fit.problem, fit.to_dict()
    lines = [
        f"{problem.name}: {counted(fit.n, 'reading')} in "
        f"{counted(len(problem.experiments), 'experiment')}, "
        f"{counted(len(problem.parameters), 'parameter')}, "
        f"{fit.solution.histories} histories",
        *parameter_lines(outcome),
        *(f"  {line}" for line in process_lines(outcome)),
    ]
    if not problem.scatters:
        lines.append(f"  intervals {of_specimens(outcome)}")
    verdict = "the law does not fit: " if fit.flagged else "the law fits: "
    lines += [verdict * (fit.p_value is not None) + goodness(outcome), "checks:"]
    rows = check_rows(outcome)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for name, number, limit, passed in rows:
        cells = (name.ljust(widths[0]), number.rjust(widths[1]), limit.ljust(widths[2]), passed)
        lines.append(f"  {'  '.join(cells)}")
    lines += warning_lines(doubt.text for doubt in fit.doubts)
    if fit.alternatives or fit.failed:
        lines += _law_lines(outcome)
    return "\n".join(lines)


def parameter_lines(outcome: Mapping[str, Any]) -> list[str]:
    """Return a line of each key, its verdict last, and lines about its scatter."""
    level, parameters = outcome["level"], outcome["parameters"]
    width, lines = max(map(len, parameters)), []
    for key, entry in parameters.items():
        subject = " of the material" * (entry["of"] == "material")
        row, *derived = key_rows(key, entry)
        text = f"{row.value}{subject}  {row.ends}".rstrip()
        lines.append(f"  {key.ljust(width)}  {text} ({100 * level:g} %)  {row.verdict}")
        for other in derived:
            text = f"{other.label} {other.value}  {other.ends} ({other.note})"
            lines.append(f"  {' ' * width}  {text}")
        lines += [f"    {line}" for line in scatter_lines(entry, level)]
    return lines


def _law_lines(outcome: Mapping[str, Any]) -> list[str]:
    rows = law_rows(outcome)
    lines = ["laws compared (AIC above the smallest, BIC, chi2, probability, parameters):"]
    for name, *numbers, parameters, verdict in rows:
        flag = "; does not fit" * (verdict == "does not fit")
        text = f"{', '.join(numbers)}; {parameters}{flag}" if parameters else verdict
        lines.append(f"  {name}: {text}")
    return lines
