"""Loops that are compiled ahead: what they return, and what they refuse."""

import math

import numpy as np
import pytest
from commands import python

from ringwear_par.compiled import error_rows
from ringwear_par.compiled.machine_code import load

VALUES, PRESSURES = np.array([[1.0, -3.0], [math.nan, 1.0]]), np.array([[1.0, 2.0], [4.0, 2.0]])


def largest_ratios(values=VALUES):
    """Return what the loop of this name sets, of 2 rows."""
    ratios = np.empty(2)
    load(error_rows).largest_ratios(2, 2, values, PRESSURES, np.array([2.0, 0.0]), ratios)
    return ratios


def test_no_number_stays_none():
    np.testing.assert_equal(largest_ratios(), [1.5, math.nan])


@pytest.mark.parametrize(
    "values", [VALUES.astype(np.float32), VALUES.T, np.int64([[1, 2], [3, 4]])]
)
def test_arrays_of_other_types_or_orders_are_refused(values):
    with pytest.raises((TypeError, ValueError)):
        largest_ratios(values)


def test_kept_code_is_loaded_without_the_compiler():
    load(error_rows)
    program = (
        "import sys; from ringwear_par.compiled import error_rows, machine_code; "
        "machine_code.load(error_rows); assert 'numba' not in sys.modules"
    )
    assert not python("-c", program).returncode
