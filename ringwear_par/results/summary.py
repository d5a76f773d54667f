"""A run in a few lines, and its numbers as a dict."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from ringwear_par.cases.case import SAME_TIME
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import LONGEST_SENTENCE, legible, warning_lines
from ringwear_par.results.key_numbers import (
    BALANCES,
    MESH_BALANCES,
    TIME_STEPS,
    KeyNumber,
    check_numbers,
    key_numbers,
)
from ringwear_par.results.result import Result

#: errors of balances above which a computation does not satisfy its equations; of eq. (3) itself,
#: which blocks solve to a part of the tolerance of wear
_MOST_ERROR, _MOST_RESIDUAL = 1e-6, 5e-2
#: letters of the first column of lines
_LABEL = 13


def labelled(lines: Iterable[tuple[str, str]]) -> list[str]:
    """Return lines of a summary: what it is, and the answer behind it."""
    return [f"{label.ljust(_LABEL)}{text}" for label, text in lines]


def summary(result: Result) -> str:
    """Return a result in a few lines, see ``Result.summary``."""
    numbers = {number.name: number for number in key_numbers(result)}
    warnings, (wrong, errors) = warnings_of(result), checks(result)
    words = [f"{len(warnings)} warning{'s' * (len(warnings) > 1)}, above"] if warnings else []
    words += [f"wrong: {', '.join(wrong)}"] if wrong else []
    answers = [*_answers(result, numbers), ("checks", f"{'; '.join(words) or 'ok'} ({errors})")]
    lines = [*warning_lines(warnings), *labelled(answers)]
    return "\n".join(legible(line, LONGEST_SENTENCE) for line in lines)


def _answers(result: Result, numbers: Mapping[str, KeyNumber]) -> Iterator[tuple[str, str]]:
    """Yield the answers of a run, one a line, with four digits."""

    def text(name: str, words: str = "{}") -> str:
        """Return a number within words, "" where there is none."""
        if (number := numbers.get(name)) is None:
            return ""
        if not number.known:
            return words.format(f"{number.label} unknown ({number.note})")
        return words.format(f"{number.text} {number.unit}".strip())

    if early := early_end(result):
        yield "ended", early
    parts = text("worn_off", " (worn off {}") + text("elastic", ", elastic {})")
    yield "penetration", text("penetration") + parts
    worn, rates = [], []
    for body in BODIES:
        if f"{body}_worn_volume" not in numbers:
            continue
        mass = text(f"{body}_mass", ", {}") if f"mass_lost_{body}" in result.data else ""
        deepest = text(f"{body}_deepest_wear", ", {} at most")
        through = text(f"{body}_share_through", ", {} of its area without layers")
        worn.append(f"{body} {text(f'{body}_worn_volume')}{mass}{deepest}{through}")
        specific = text(f"{body}_specific_rate", ", {} over the test")
        rates.append(text(f"{body}_last_rate", f"{body} {{}} at the end") + specific)
    yield "worn", "; ".join(worn) or "nothing wears"
    yield "wear rate", "; ".join(filter(None, rates)) or "none"
    where = text("r_largest_pressure", " at most (r = {})")
    largest = text("largest_pressure", f"{{}}{where}, ")
    elements = f"{text('touching')} of {result.line.n} elements touch"
    elements += "" if largest else ": the faces do not touch"
    yield "pressure", f"{text('mean_pressure')} mean, {largest}{elements}"
    energy = text("dissipated_energy")
    yield "torque", f"{text('torque')}, force {text('force')}, friction energy {energy}"


def early_end(result: Result) -> str:
    """Return where a limit ended a history before its time, "" if none did."""
    about, ended = result.attributes, float(result.data["time"][-1])
    if about["status"] != "complete" or ended >= about["time_end"] * (1.0 - SAME_TIME):
        return ""
    limit = about.get("stopped_by", "a limit of [stop]")
    return f"at t = {ended:g} of {about['time_end']:g} s, where it reached {limit}"


def checks(result: Result) -> tuple[list[str], str]:
    """Return balances that are not what the equations say, and the largest errors, in words."""
    numbers = check_numbers(result)
    balances = [number for number in numbers if number.group == BALANCES]
    wrong = [
        f"{n.label} {n.text}"
        for n in balances
        if n.value > (_MOST_RESIDUAL if n.name == "balance_residual" else _MOST_ERROR)
    ]
    mesh = max(number.value for number in numbers if number.group == MESH_BALANCES)
    worst = max((number.value for number in balances), default=0.0)
    words = [f"balances to {worst:.0e}", f"mesh to {mesh:.0e}"]
    steps = [number for number in numbers if number.group == TIME_STEPS]
    words += [f"time steps to {number.text} {number.unit} in all" for number in steps]
    return wrong, ", ".join(words)


def to_dict(result: Result) -> dict[str, Any]:
    """Return title, status, warnings and numbers, see ``Result.to_dict``."""
    numbers = [*key_numbers(result), *check_numbers(result)]
    return {
        **{name: result.attributes[name] for name in ("title", "status", "error")},
        "doubts": [doubt.to_dict() for doubt in result.doubts],
        "warnings": [doubt.text for doubt in result.doubts],
        "numbers": {
            n.name: {"value": n.value if n.known else None, "unit": n.unit} for n in numbers
        },
    }


def warnings_of(result: Result) -> list[str]:
    """Return how far a history is that has not come to its end, and what is doubted, in words."""
    about, sentences = result.attributes, []
    if about["status"] != "complete":
        time = f"t = {result.data['time'][-1]:g} of {about['time_end']:g} s"
        where = f"step {result.step[-1]}, {time}"
        sentences.append(
            f"failed after {where}: {about['error']}"
            if about["error"]
            else f"stopped after {where}: ringwear run --restart continues it"
        )
    sentences += [doubt.text for doubt in result.doubts]
    for body in BODIES if result.data["dissipated_energy"][-1] > 0.0 else ():
        law = about[f"law_{body}"]
        if law and result.data[f"worn_volume_{body}"][-1] == 0.0:
            reason = f"its pressures never reach what wears, by {law}"
            sentences.append(f"nothing of {body} is worn off: {reason}")
    return sentences
