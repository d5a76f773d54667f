"""Wear laws tried before a case runs, and ``ringwear laws``, which tests their derivatives."""

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.reading import read_case
from ringwear_par.errors import LONGEST_SENTENCE, ComputationError, InputError, legible
from ringwear_par.schedules import largest
from ringwear_par.wear.checked_law import CompletedLaw, complete
from ringwear_par.wear.law import Law
from ringwear_par.wear.laws import LAWS
from ringwear_par.wear.laws.user import UserLaw
from ringwear_par.wear.local_state import LocalState
from ringwear_par.wear.trials import (
    Remainders,
    check_object,
    check_user_law,
    check_user_slope,
    depends,
    step_error,
    taylor_test,
    taylor_test_parameter,
    taylor_test_wear,
)

_OURS = set(LAWS.values()) - {UserLaw}
_ELEMENTS = 60
#: pressures up to which laws are tried: of ``ringwear laws``, MPa, and in mean pressures of a case
_PRESSURE = 300.0
_MEANS = 5.0
_STEP = 1.0  # s
_WORN = 1e-3  # mm
#: mm, shorter than the depths over which rates change in practice
_DEPTH = 1e-5
#: relative error of depths of implicit steps that is round-off
_ROUND_OFF = 1e-12
_PRESSURES = (0.0, 10.0, 50.0, 100.0, 200.0)
_MOST_TIMES = 5


def _name(table: str) -> str:
    """Return the body or layer that wears by the law in a table: "lower", "lower.layers[0]"."""
    return table.removeprefix("wear.").removesuffix(".wear")


def law_sources(case: Case) -> dict[str, str]:
    """Return the texts of the user's own laws by body."""
    laws = case.laws_by_table.items()
    return {_name(table): law.source for table, law in laws if isinstance(law, UserLaw)}


def law_files(case: Case) -> dict[str, str]:
    """Return the names of the Python files of a case's laws by key."""
    laws = case.laws_by_table.items()
    return {f"{table}.file": law.file for table, law in laws if isinstance(law, UserLaw)}


def refuse_bad_laws(case: Case, name: str, slopes: bool = True) -> None:
    """Refuse users' laws that are none, or whose slopes are wrong: from files, and objects.

    Not collective.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    faults: list[str] = []
    pressure = _PRESSURE
    if case.load.force is not None:
        pressure = _MEANS * largest(case.load.force) / case.area
    for table, original in case.laws_by_table.items():
        if original is not None and type(original) not in _OURS:  # which are what they should be
            law = original if isinstance(original, UserLaw) else CompletedLaw(original)
            key = f"{table}.file" if isinstance(law, UserLaw) else table
            try:
                if law is not original:
                    check_object(original)
                check_user_law(law, _local_state(case, 0.0, 0.0), pressure)
                if slopes:
                    check_user_slope(law, _local_state(case, 0.0, 0.0), pressure)
            except InputError as error:
                faults += [f"{name}: {key}: {fault}" for fault in error.faults]
    if faults:
        raise InputError(*faults)


def _local_state(case: Case, time: float, worn: float) -> LocalState:
    """Return the local state along the contact at a time, at the largest speed, or 1 rad/s."""
    r = np.linspace(*case.contact, _ELEMENTS, dtype=np.float64)
    speed = (largest(case.load.omega) or 1.0) * r
    return LocalState(time, r, speed, largest(case.friction), np.full_like(r, worn), speed * _STEP)


def check_laws(path: Path, overrides: Sequence[str]) -> None:
    """Print rates and Taylor tests of a case's laws. On one rank.

    Raises
    ------
    InputError : the case, or a user's law that is none.
    ComputationError : a user's function failed, or a derivative or depth is not that of its rate.
    """
    case = read_case(path, overrides)
    refuse_bad_laws(case, str(path), slopes=False)
    laws = {_name(table): law for table, law in case.laws_by_table.items()}
    failed = sum(_tested(case, body, complete(law)) for body, law in laws.items() if law)
    for body, law in laws.items():
        if law is None:
            print(f"{body}: does not wear")
    if failed:
        raise ComputationError(
            f"{path}: {failed} derivative(s) or depths of steps of its wear laws are not those of "
            f"its rates; the order must be 2, the error of depths at most {_ROUND_OFF:g}"
        )


def _tested(case: Case, body: str, law: Law) -> int:
    """Print what a law does; return how many of its derivatives are wrong."""
    rng = np.random.default_rng(1)
    p, direction = rng.uniform(1.0, _PRESSURE, _ELEMENTS), rng.uniform(-1.0, 1.0, _ELEMENTS)
    fresh = _local_state(case, 0.0, 0.0)
    rates = [float(law.rate(np.full_like(p, v), fresh).max()) for v in _PRESSURES]
    print(
        f"{body}: {legible(law.describe(), LONGEST_SENTENCE)}\n  largest rate at p = "
        f"{', '.join(f'{q:g}' for q in _PRESSURES)} MPa, t = 0, "
        f"omega = {largest(case.load.omega) or 1.0:g} rad/s: "
        f"{', '.join(f'{rate:.4g}' for rate in rates)} mm/s"
    )
    failed = 0
    middles = [0.5 * (a + b) for a, b in itertools.pairwise((0.0, *case.breakpoints))]
    for time in (0.0, *middles[: _MOST_TIMES - 1]):
        for worn in (0.0, _WORN):
            at = _local_state(case, time, worn)
            for step, subject in (
                (0.0, "rate"),
                (_STEP, f"wear of an implicit step of {_STEP:g} s"),
            ):
                test = taylor_test(law, at, p, direction, step) if law.rate(p, at).any() else None
                failed += _print_test(
                    test, f"derivative of the {subject}, t = {time:g} s, {worn:g} mm worn"
                )
            if law.remembers:
                test = taylor_test_wear(law, at, p, _DEPTH) if law.rate(p, at).any() else None
                subject = "derivative of the rate with respect to worn depth"
                failed += _print_test(test, f"{subject}, t = {time:g} s, {worn:g} mm worn")
                failed += _print_error(
                    step_error(law, at, p, _STEP),
                    f"depth of an implicit step of {_STEP:g} s, t = {time:g} s, {worn:g} mm worn",
                )
        for name in law.numeric:
            # a law's memory has an effect only where something is worn
            wears, where = law.rate(p, at).any(), f"t = {time:g} s, {_WORN:g} mm worn"
            if wears and not depends(law, at, p, name):
                print(f"  {'-':4} the rate does not depend on {name}, {where}")
                continue
            test = taylor_test_parameter(law, at, p, name) if wears else None
            failed += _print_test(test, f"derivative of the rate with respect to {name}, {where}")
    return failed


def _print_error(error: float | None, subject: str) -> bool:
    """Print the error of depths that a law gives itself, if any; return whether it is too large."""
    if error is None:
        return False
    failed = not error <= _ROUND_OFF
    print(f"  {'FAIL' if failed else 'ok':4} {subject}: relative error {error:.1g}")
    return failed


def _print_test(test: Remainders | None, subject: str) -> bool:
    """Print the result of a test, None where nothing wears; return whether it failed."""
    if test is None:
        print(f"  {'-':4} {subject}: Taylor remainder: no wear, not tested")
        return False
    order = "none left" if math.isinf(test.order) else f"order {test.order:.2f}"
    if test.passed and test.order < 1.9:
        order += ", as its kinks explain"
    print(f"  {'ok' if test.passed else 'FAIL':4} {subject}: Taylor remainder: {order}")
    return not test.passed
