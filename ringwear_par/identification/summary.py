"""The numbers of a fit as people read them: rows and sentences, and the summary made of them.

The page of a fit has the same ones. An ``outcome`` is the contents of fit.json, an ``entry`` those
of a key.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.special import softmax

from ringwear_par.cases.units import CUSTOMARY
from ringwear_par.errors import counted, warning_lines
from ringwear_par.identification.definition.problem import PLURALS, body_of_wear

Entry = Mapping[str, Any]

#: headers of the table of laws; cells are "" where there is nothing
LAWS = ("law", "probability", "chi2", "parameters", "verdict")
#: remarks on scatters by their verdicts
_NOTES = {"at bound": ", perhaps none", "not identified": ", mostly by its prior"}
#: digits of numbers: draws know no more
_DIGITS = 3


class KeyRow(NamedTuple):
    """A number of a fitted key, in the unit that its user writes."""

    #: the key, or what the number is where it is another one
    label: str
    #: None where it is at a bound, and the interval tells more
    estimate: float | None
    sd: float
    #: ends of its interval, None where there is no limit
    low: float | None
    high: float | None
    unit: str
    #: on the key, "" of a number that has none
    verdict: str = ""
    #: a remark on the number
    note: str = ""

    @property
    def digits(self) -> int:
        """How many digits its numbers have."""
        return digits_within(self.low, self.high)

    @property
    def ends(self) -> str:
        """The interval in words."""
        return limits(self.low, self.high)

    @property
    def value(self) -> str:
        """The estimate with its unit, or the limit."""
        value = self.ends if self.estimate is None else number(self.estimate, self.digits)
        return f"{value} {self.unit}".rstrip()


def digits_within(low: float | None, high: float | None) -> int:
    """Return how many digits the numbers of an interval are told with: no more than draws know."""
    if low is None or high is None or low == high:
        return _DIGITS
    return max(_DIGITS, 2 + int(np.log10(max(abs(low), abs(high)) / (high - low))))


def number(value: float, digits: int = _DIGITS) -> str:
    """Return a number with some significant digits, without an exponent up to a million."""
    return f"{float(f'{value:.{digits}g}'):.{max(digits, 6)}g}"


def limits(low: float | None, high: float | None) -> str:
    """Return an interval in words."""
    if low is None:
        return "no limit within its bounds" if high is None else f"less than {number(high)}"
    if high is None:
        return f"more than {number(low)}"
    digits = digits_within(low, high)
    return f"from {number(low, digits)} to {number(high, digits)}"


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
    low, high = in_unit["interval"]
    rows = [KeyRow(key, estimate, in_unit["sd"], low, high, unit, verdict)]
    rate = entry.get("specific_wear_rate")
    if rate is not None and verdict != "not identified":
        product = f"k mu at mu = {rate['mu']:.{_DIGITS}g}" if "mu" in rate else "k"
        note = f"{product}; {rate[CUSTOMARY]:.{_DIGITS}g} {CUSTOMARY}"
        estimate, sd, unit, (low, high) = (rate[n] for n in ("estimate", "sd", "unit", "interval"))
        rows.append(KeyRow("specific wear rate", estimate, sd, low, high, unit, note=note))
    return rows


def law_rows(outcome: Entry) -> list[tuple[str, ...]]:
    """Return the cells of the laws compared, see ``LAWS``, the most probable first."""
    rows, laws = list[tuple[str, ...]](), {"this law": outcome, **outcome["alternatives"]}
    # as if all laws were equally probable before
    shares = softmax([law.get("evidence", -np.inf) for law in laws.values()])
    every = zip(shares.tolist(), laws.items(), strict=True)
    for share, (name, law) in sorted(every, key=lambda one: -one[0]):
        if "error" in law:
            rows.append((name, "", "", "", f"failed: {law['error']}"))
            continue
        first = [key_rows(key, entry)[0] for key, entry in law["parameters"].items()]
        parameters = ", ".join(f"{row.label} {row.value}" for row in first)
        probability = f"{share:.2g}" if share >= 1e-4 else "< 1e-4"
        verdict = "does not fit" if law["flagged"] else "fits"
        verdict = "not tested" if law["p_value"] is None else verdict
        rows.append((name, probability, f"{law['chi2']:.4g}", parameters, verdict))
    return rows


def goodness(outcome: Entry) -> str:
    """Return chi2, its degrees of freedom and p-value in a sentence."""
    series = [entry for test in outcome["experiments"].values() for entry in test.values()]
    limited = sum(entry.get("censored", 0) for entry in series)
    of = counted(outcome["n_data"] - limited, "reading")
    of += f" and {counted(limited, 'limit')}" * bool(limited)
    test = "no p-value: readings are limits, or their noise was fitted, or has long tails"
    if (p_value := outcome["p_value"]) is not None:
        test = f"p = {p_value:.2g}"
        test += " of the readings whose sd is given" * any("sd" in entry for entry in series)
    freedom = f"{outcome['degrees_of_freedom']:.4g} degrees of freedom"
    return f"chi2 = {outcome['chi2']:.4g} of {of}, {freedom} ({test})"


def of_specimens(outcome: Entry) -> str:
    """Return the sentence that says what intervals without scatter are of."""
    count = outcome["specimens"]
    specimens = "this specimen" if count == 1 else f"these {count} specimens"
    return (
        f"of {specimens} only: repeats of a material scatter more "
        '(with repeats, use scatter = "fit")'
    )


def _size(entry: Entry, times: float, unit: str) -> str:
    """Return the size of a scatter or of random wear, times a factor, with its interval."""
    if "known" in entry:
        return f"{times * entry['known']:.2g}{unit} (taken as known)"
    size, (low, high) = f"{times * entry['estimate']:.2g}{unit}", entry["interval"]
    if low is None:
        return size
    note = _NOTES.get(entry.get("verdict", ""), "")
    return f"{size} ({times * low:.2g} to {times * high:.2g}{unit}{note})"


def scatter_lines(entry: Entry, level: float) -> list[str]:
    """Return sentences about the scatter of a key, none without."""
    if entry["of"] != "material":
        return []
    numbers, unit = users_numbers(entry)
    unit = f" {unit.partition(' per ')[0]}".rstrip()
    times, of_size = (100.0, " %") if "mean" in entry else (1.0 / numbers["scale"], unit)
    sizes = []
    for group, scatter in entry["scatter"].items():
        groups = PLURALS[group] if scatter["groups"] > 1 else group
        sizes.append(f"between {scatter['groups']} {groups} {_size(scatter, times, of_size)}")
    following = f"the next specimen: {limits(*numbers['next'])}{unit} ({100 * level:g} %)"
    for name, symbol in (("repeatability", "r"), ("reproducibility", "R")):
        if name in entry:
            following += f"; {name} {symbol} = {times * entry[name][symbol]:.2g}{of_size}"
    lines = ["; ".join(sizes), following]
    if (needed := entry["specimens_for_10_percent"]) is not None:
        lines.append(f"an interval of +-10 % for the material needs about {needed} specimens")
    return lines


def process_lines(outcome: Entry) -> list[str]:
    """Return a sentence about each body whose wear is itself random, and what follows of it."""
    lines = []
    for key, entry in outcome["process"].items():
        share = _size(entry["share"], 100.0, " %")
        depth, events = f"{1e3 * entry['depth']:.3g} um", entry["size"].get("estimate")
        text = f"wear of {body_of_wear(key)} fluctuates: sd {share} of the {depth} worn at the end"
        if events is not None:
            text += f"; events of {1e6 * events:.3g} nm  {entry['verdict']}"
        lines.append(text)
    return lines


def check_rows(outcome: Entry) -> list[tuple[str, str, str, str]]:
    """Return name, statistic, limit and outcome of all that was checked."""
    rows = []
    for check in outcome["checks"]:
        value, limit = check["value"], f"{check['must']} {check['limit']:g}"
        told = "-" if value is None else f"{value:.0f}" if value > 100.0 else f"{value:.2g}"
        rows.append((check["name"], told, limit, "pass" if check["pass"] else "FAIL"))
    return rows


def summary(name: str, outcome: Entry) -> str:
    """Return the outcome on one screen: the keys, whether the law fits, what was checked."""
    parameters, level = outcome["parameters"], outcome["level"]
    lines = [
        f"{name}: {counted(outcome['n_data'], 'reading')} in "
        f"{counted(len(outcome['experiments']), 'experiment')}, "
        f"{counted(len(parameters), 'parameter')}, {outcome['histories']} histories"
    ]
    width = max(map(len, parameters))
    for key, entry in parameters.items():
        row, *derived = key_rows(key, entry)
        of = " of the material" * (entry["of"] == "material")
        text = f"{row.value}{of}  {row.ends * (row.estimate is not None)}".rstrip()
        lines.append(f"  {key.ljust(width)}  {text} ({100 * level:g} %)  {row.verdict}")
        indent = " " * (4 + width)
        lines += [f"{indent}{r.label} {r.value}  {r.ends} ({r.note})" for r in derived]
        lines += [f"    {line}" for line in scatter_lines(entry, level)]
    lines += [f"  {line}" for line in process_lines(outcome)]
    if all(entry["of"] == "specimens" for entry in parameters.values()):
        lines.append(f"  intervals {of_specimens(outcome)}")
    verdict = "the law does not fit: " if outcome["flagged"] else "the law fits: "
    lines += [verdict * (outcome["p_value"] is not None) + goodness(outcome), "checks:"]
    rows = check_rows(outcome)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for check, value, limit, passed in rows:
        cells = (check.ljust(widths[0]), value.rjust(widths[1]), limit.ljust(widths[2]), passed)
        lines.append(f"  {'  '.join(cells)}")
    lines += warning_lines(outcome["warnings"])
    if outcome["alternatives"]:
        lines.append(f"laws compared ({', '.join(LAWS[1:])}):")
        lines += [f"  {law}: {', '.join(filter(None, cells))}" for law, *cells in law_rows(outcome)]
    return "\n".join(lines)
