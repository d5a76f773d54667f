"""A run in a few lines, and its numbers as a dict."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from ringwear_par.cases.case import SAME_TIME
from ringwear_par.cases.schema import SCHEMES
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
from ringwear_par.results.laboratory_numbers import densities_of
from ringwear_par.results.result import Result

#: errors of balances above which a computation does not satisfy its equations
_MOST_ERROR = 1e-6
#: letters of the first column of lines
_LABEL = 13


def labelled(lines: Iterable[tuple[str, str]]) -> list[str]:
    """Return lines of a summary: what it is, and the answer behind it."""
    return [f"{label.ljust(_LABEL)}{text}" for label, text in lines]


def summary(result: Result) -> str:
    """Return a result in a few lines, as ``ringwear run`` prints it.

    Raises
    ------
    InputError : the result was stored without its last state.
    """
    numbers = {number.name: number for number in key_numbers(result)}
    warnings, (wrong, errors) = warnings_of(result), checks(result)
    words = [f"{len(warnings)} warning{'s' * (len(warnings) > 1)}, above"] if warnings else []
    words += [f"wrong: {', '.join(wrong)}"] if wrong else []
    answers = [*_answers(result, numbers), ("checks", f"{'; '.join(words) or 'ok'} ({errors})")]
    lines = [*warning_lines(warnings), *labelled(answers)]
    return "\n".join(legible(line, LONGEST_SENTENCE) for line in lines)


def _answers(result: Result, numbers: Mapping[str, KeyNumber]) -> Iterator[tuple[str, str]]:
    """Yield the answers of a run, one a line, with four digits."""

    def text(name: str) -> str:
        number = numbers[name]
        if not number.known:
            return f"{number.label} unknown ({number.note})"
        return f"{number.text} {number.unit}"

    if early := early_end(result):
        yield "ended", early
    parts = ""
    if "worn_off" in numbers:
        parts = f" (worn off {text('worn_off')}, elastic {text('elastic')})"
    yield "penetration", f"{text('penetration')}{parts}"
    worn, rates = [], []
    for body in BODIES:
        if f"{body}_worn_volume" not in numbers:
            continue
        amounts = text(f"{body}_worn_volume")
        if np.isfinite(densities_of(result, body)).any():
            amounts += f", {text(f'{body}_mass')}"
        worn.append(f"{body} {amounts}, {text(f'{body}_deepest_wear')} at most")
        if f"{body}_share_through" in numbers:
            worn[-1] += f", {text(f'{body}_share_through')} of its area without layers"
        if f"{body}_last_rate" in numbers:
            rates.append(f"{body} {text(f'{body}_last_rate')} at the end")
        if f"{body}_specific_rate" in numbers:
            rates[-1] += f", {text(f'{body}_specific_rate')} over the test"
    yield "worn", "; ".join(worn) or "nothing wears"
    yield "wear rate", "; ".join(rates) or "none"
    elements = f"{numbers['touching'].text} of {result.line.n} elements touch"
    if "largest_pressure" in numbers:
        place = f"(r = {text('r_largest_pressure')})"
        elements = f"{text('largest_pressure')} at most {place}, {elements}"
    else:
        elements += ": the faces do not touch"
    yield "pressure", f"{text('mean_pressure')} mean, {elements}"
    energy = text("dissipated_energy")
    yield "torque", f"{text('torque')}, force {text('force')}, friction energy {energy}"


def early_end(result: Result) -> str:
    """Return where a limit ended a history before its time, "" if none did."""
    about, ended = result.attributes, float(result.histories["time"][-1])
    if about["status"] != "complete" or ended >= about["time_end"] * (1.0 - SAME_TIME):
        return ""
    limit = about.get("stopped_by", "a limit of [stop]")
    return f"at t = {ended:g} of {about['time_end']:g} s, where it reached {limit}"


def checks(result: Result) -> tuple[list[str], str]:
    """Return balances that are not what the equations say, and the largest errors, in words."""
    numbers = check_numbers(result)
    balances = [number for number in numbers if number.group == BALANCES]
    wrong = [f"{n.label} {n.text}" for n in balances if n.value > _MOST_ERROR]
    mesh = max(number.value for number in numbers if number.group == MESH_BALANCES)
    worst = max((number.value for number in balances), default=0.0)
    words = [f"balances to {worst:.0e}", f"mesh to {mesh:.0e}"]
    steps = [number for number in numbers if number.group == TIME_STEPS]
    words += [f"time steps to {number.text} {number.unit} in all" for number in steps]
    return wrong, ", ".join(words)


def to_dict(result: Result) -> dict[str, Any]:
    """Return title, status, warnings and key numbers with their units, as JSON can hold them.

    Raises
    ------
    InputError : the result was stored without its last state.
    """
    numbers = [*key_numbers(result), *check_numbers(result)]
    return {
        "title": result.attributes["title"],
        "status": result.attributes["status"],
        "error": result.attributes["error"],
        "doubts": [doubt.to_dict() for doubt in result.doubts],
        "warnings": [doubt.text for doubt in result.doubts],
        "numbers": {
            number.name: {
                "value": float(number.value) if number.known else None,
                "unit": number.unit,
            }
            for number in numbers
        },
    }


def warnings_of(result: Result) -> list[str]:
    """Return how far a history is that has not come to its end, and what is doubted, in words.

    The result has its last state.
    """
    assert result.checkpoint is not None
    about, last, sentences = result.attributes, result.checkpoint, []
    if about["status"] != "complete":
        where = f"t = {last.state.time:g} of {about['time_end']:g} s"
        if not SCHEMES[about["scheme"]].adaptive:
            where = f"step {int(last.progress.steps)} of {about['time_steps']}"
        sentences.append(
            f"failed after {where}: {about['error']}"
            if about["error"]
            else f"stopped after {where}: ringwear run --restart continues it"
        )
    sentences += [doubt.text for doubt in result.doubts]
    for body in BODIES if result.histories["dissipated_energy"][-1] > 0.0 else ():
        law = about[f"law_{body}"]
        if law and result.histories[f"worn_volume_{body}"][-1] == 0.0:
            reason = f"its pressures never reach what wears, by {law}"
            sentences.append(f"nothing of {body} is worn off: {reason}")
    return sentences
