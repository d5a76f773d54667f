"""A run in a few lines, in all its numbers, or as a dict."""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from ringwear_par.cases.case import CHANGED, SAME_TIME
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.schema import BY_PATH, SCHEMES
from ringwear_par.cases.values import is_number
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import LONGEST_SENTENCE, legible, warning_lines
from ringwear_par.results.key_numbers import (
    BALANCES,
    MESH_BALANCES,
    TIME_STEPS,
    KeyNumber,
    check_numbers,
    in_groups,
    key_numbers,
    number_words,
)
from ringwear_par.results.laboratory_numbers import densities_of
from ringwear_par.results.result import Checkpoint, Result

#: errors of balances above which a computation does not satisfy its equations
_MOST_ERROR = 1e-6
#: letters of the first column of lines
_LABEL = 13


def labelled(lines: Iterable[tuple[str, str]]) -> list[str]:
    """Return lines of a summary: what it is, and the answer behind it."""
    return [f"{label.ljust(_LABEL)}{text}" for label, text in lines]


def summary(result: Result, verbose: bool = False) -> str:
    """Return a result in a few lines, as ``ringwear run`` prints it. Not collective.

    Parameters
    ----------
    verbose : all key numbers and checks instead.

    Raises
    ------
    InputError : the result was stored without its last state.
    """
    numbers = key_numbers(result)
    assert result.checkpoint is not None
    if verbose:
        return _in_full(result, numbers, result.checkpoint)
    warnings = _warnings(result, result.checkpoint)
    wrong, errors = checks(result)
    words = [f"{len(warnings)} warning{'s' * (len(warnings) > 1)}, above"] if warnings else []
    words += [f"wrong: {', '.join(map(str, wrong))}"] if wrong else []
    lines = [
        *warning_lines(warnings),
        *labelled(_answers(result, {number.name: number for number in numbers})),
        *labelled([("checks", f"{'; '.join(words) or 'ok'} ({errors})")]),
    ]
    return "\n".join(legible(line, LONGEST_SENTENCE) for line in lines)


def _answers(result: Result, numbers: Mapping[str, KeyNumber]) -> Iterator[tuple[str, str]]:
    """Yield the answers of a run, one a line, with four digits."""

    def text(name: str) -> str:
        number = numbers[name]
        if math.isnan(number.value):
            return f"{number.label} unknown ({number.note})"
        return f"{number_words(number.value)} {number.unit}"

    if early := early_end(result):
        yield "ended", early
    parts = ""
    if "worn_off" in numbers:
        parts = f" (worn off {text('worn_off')}, elastic {text('elastic')})"
    yield "penetration", f"{text('penetration')}{parts}"
    bodies = [body for body in BODIES if f"{body}_worn_volume" in numbers]
    worn, rates = [], []
    for body in bodies:
        weighed = [f"{body}_mass"] if np.isfinite(densities_of(result, body)).any() else []
        amounts = ", ".join(map(text, [f"{body}_worn_volume", *weighed]))
        worn.append(f"{body} {amounts}, {text(f'{body}_deepest_wear')} at most")
        if f"{body}_share_through" in numbers:
            worn[-1] += f", {text(f'{body}_share_through')} of its area without layers"
        if f"{body}_last_rate" in numbers:
            rates.append(f"{body} {text(f'{body}_last_rate')} at the end")
        if f"{body}_specific_rate" in numbers:
            rates[-1] += f", {text(f'{body}_specific_rate')} over the test"
    yield "worn", "; ".join(worn) or "nothing wears"
    yield "wear rate", "; ".join(rates) or "none"
    touching, largest = numbers["touching"], ""
    if touching.value:
        largest = f", {text('largest_pressure')} at most (r = {text('r_largest_pressure')})"
    apart = "" if touching.value else ": the faces do not touch"
    elements = f"{touching.text} of {result.line.n} elements touch{apart}"
    yield "pressure", f"{text('mean_pressure')} mean{largest}, {elements}"
    yield (
        "torque",
        (f"{text('torque')}, force {text('force')}, friction energy {text('dissipated_energy')}"),
    )


def early_end(result: Result) -> str:
    """Return where a limit ended a history before its time, "" if none did."""
    about, ended = result.attributes, float(result.histories["time"][-1])
    if about["status"] != "complete" or ended >= about["time_end"] * (1.0 - SAME_TIME):
        return ""
    limit = about.get("stopped_by", "a limit of [stop]")
    return f"at t = {ended:g} of {about['time_end']:g} s, where it reached {limit}"


def checks(result: Result) -> tuple[list[KeyNumber], str]:
    """Return balances that are not what the equations say, and the largest errors in words."""
    groups = in_groups(check_numbers(result))
    wrong = [number for number in groups.get(BALANCES, ()) if number.value > _MOST_ERROR]
    errors = {
        "balances to": max((n.value for n in groups.get(BALANCES, ())), default=0.0),
        "mesh to": max((n.value for n in groups[MESH_BALANCES]), default=0.0),
    }
    details = [f"{name} {value:.0e}" for name, value in errors.items()]
    if TIME_STEPS in groups:
        error = groups[TIME_STEPS][0]
        details.append(f"time steps to {error.text} {error.unit} in all")
    return wrong, ", ".join(details)


def _in_full(result: Result, numbers: list[KeyNumber], last: Checkpoint) -> str:
    """Return all key numbers and checks of a result, a group a line."""
    about = result.attributes
    title = str(about.get("title", ""))
    steps, iterations = int(last.progress.steps), last.progress.iterations
    checks = in_groups(check_numbers(result))
    time_steps = checks.pop(TIME_STEPS, None)
    lines = [
        *([title] if title else []),
        *warning_lines(_warnings(result, last)),
        *(f"{group}: {', '.join(map(str, them))}" for group, them in in_groups(numbers).items()),
        *([f"ended {early}"] if (early := early_end(result)) else []),
        *_wearing(about),
        *(
            f"{noun} of {body}: {about[key]}"
            for noun in ("face", "layers")
            for body in BODIES
            if (key := f"{noun}_{body}") in about
        ),
        f"{_steps(about, last)}, {result.line.n} contact elements, "
        f"{iterations / max(steps, 1):.1f} TAO iterations a step",
        *([f"mesh moved and assembled again {last.start.updates} times to follow the wear"]
          if last.start.updates else []),
        *(f"{group}: {', '.join(map(str, them))}" for group, them in checks.items()),
    ]  # fmt: skip
    if time_steps is None:
        lines.append("errors of fixed time steps are not estimated: compare with half the step")
    else:
        lines.append(f"{TIME_STEPS}, {time_steps[0]}{_tolerance(result)}. {_limits(about)}")
    return "\n".join(legible(line, LONGEST_SENTENCE) for line in lines)


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
                "value": None if np.isnan(number.value) else float(number.value),
                "unit": number.unit,
            }
            for number in numbers
        },
    }


def _steps(about: Mapping[str, Any], last: Checkpoint) -> str:
    """Return the steps of a run in words."""
    steps, scheme = int(last.progress.steps), about["scheme"]
    if not SCHEMES[scheme].adaptive:
        return f"{steps} of {about['time_steps']} {scheme} steps of {about['time_step']:g} s"
    repeated = f" (and {last.progress.rejected} repeated)" if last.progress.rejected else ""
    return f"{steps} {scheme} steps{repeated} to {last.state.time:g} s"


def _warnings(result: Result, last: Checkpoint) -> list[str]:
    """Return the sentences that come first: how far the history is, and what is doubted."""
    about, doubts = result.attributes, (doubt.text for doubt in result.doubts)
    return [*_unfinished(about, last), *doubts, *_unworn(result)]


def _unworn(result: Result) -> Iterator[str]:
    """Yield a sentence for each body whose law has worn nothing off."""
    slid = result.histories["dissipated_energy"][-1] > 0.0
    for body in BODIES:
        law = result.attributes[f"law_{body}"]
        if law and slid and result.histories[f"worn_volume_{body}"][-1] == 0.0:
            yield f"nothing of {body} is worn off: its pressures never reach what wears, by {law}"


def _unfinished(about: Mapping[str, Any], last: Checkpoint) -> list[str]:
    """Return how far a history is that has not come to its end, nothing if it has."""
    if about["status"] == "complete":
        return []
    where = f"t = {last.state.time:g} of {about['time_end']:g} s"
    if not SCHEMES[about["scheme"]].adaptive:
        where = f"step {int(last.progress.steps)} of {about['time_steps']}"
    if about["error"]:
        return [f"failed after {where}: {about['error']}"]
    return [f"stopped after {where}: ringwear run --restart continues it"]


def _wearing(about: Mapping[str, Any]) -> list[str]:
    """Return the wear law of each body."""
    laws = {body: about[f"law_{body}"] for body in BODIES}
    if not any(laws.values()):
        return ["nothing wears"]
    return [f"{body} wears by {law}" for body, law in laws.items() if law]


def _limits(about: Mapping[str, Any]) -> str:
    """Return the sentence about what the estimated error of time steps leaves out."""
    if about["closing_contact"]:
        return "The errors of the mesh and of elements that come into contact are not included."
    return "The error of the mesh is not included."


def _tolerance(result: Result) -> str:
    """Return the tolerance of adaptive steps in words, "" where the stored case has none."""
    if result.case.startswith(CHANGED):
        return ""
    key = BY_PATH["time.tolerance"]
    tolerance = read_keys(result.case).get(key.path, key.default)
    return f" (tolerance {1e3 * tolerance:g} um)" if is_number(tolerance) else ""
