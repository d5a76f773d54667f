"""``ringwear laws``: what the wear laws of a case do, and whether their derivatives are right."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ringwear_par.case import read_case
from ringwear_par.errors import ComputationError
from ringwear_par.quantity import largest
from ringwear_par.wear import Sliding, UserLaw, check_user_law, taylor_test

_ELEMENTS = 60
_PRESSURE = 300.0  # MPa
_STEP = 1.0  # s
_WORN = 1e-3  # mm
_KINKED = 0.1
_SHOWN = (0.0, 10.0, 50.0, 100.0, 200.0)


def check_laws(path: Path, overrides: Sequence[str]) -> int:
    """Print rates and Taylor tests of a case's laws; return 0 if all passed, else 1. On one rank.

    Raises
    ------
    InputError : the case, or a user's law that is none.
    ComputationError : a user's function failed.
    """
    case = read_case(path, overrides)
    inner, outer = case.contact
    r = np.linspace(inner, outer, _ELEMENTS)
    speed = largest(case.load.omega) * r
    rng = np.random.default_rng(1)
    p, direction = rng.uniform(1.0, _PRESSURE, _ELEMENTS), rng.uniform(-1.0, 1.0, _ELEMENTS)
    failed = 0
    for body, law in zip(("lower", "upper"), case.laws, strict=True):
        if law is None:
            print(f"{body}: does not wear")
            continue
        fresh = Sliding(0.0, r, speed, case.friction, np.zeros_like(r), np.zeros_like(r))
        if isinstance(law, UserLaw):
            check_user_law(law, fresh, _PRESSURE)
        rates = [float(law.rate(np.full_like(r, v), fresh).max()) for v in _SHOWN]
        told = ", ".join(f"{q:g}" for q in _SHOWN)
        print(f"{body}: {type(law).__name__}, largest rate at p = {told} MPa and t = 0: "
              + ", ".join(f"{rate:.4g}" for rate in rates) + " mm/s")  # fmt: skip
        for worn in (0.0, _WORN):
            at = Sliding(0.0, r, speed, case.friction, np.full_like(r, worn), speed * _STEP)
            for step, what in ((0.0, "rate"), (_STEP, f"wear of an implicit step of {_STEP:g} s")):
                test = taylor_test(law, at, p, direction, step, _KINKED)
                failed += not test.passed
                order = "none left" if math.isinf(test.order) else f"order {test.order:.2f}"
                print(f"  {'ok' if test.passed else 'FAIL':4} derivative of the {what}, "
                      f"{worn:g} mm worn: Taylor remainder, {order}")  # fmt: skip
    if failed:
        raise ComputationError(
            f"{path}: {failed} derivative(s) of its wear laws are not those of its rates; the "
            "order must be 2"
        )
    return 0
