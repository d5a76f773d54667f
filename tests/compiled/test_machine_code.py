"""Loops that are compiled ahead: where their code is kept, and what they refuse."""

import ast
import importlib.util
import inspect
import math
import sys

import numpy as np
import pytest
from commands import python

from ringwear_par.compiled import contact_rows, machine_code, step_rows
from ringwear_par.compiled.machine_code import load

VALUES, PRESSURES = np.array([[1.0, -3.0], [math.nan, 1.0]]), np.array([[1.0, 2.0], [4.0, 2.0]])


def largest_ratios(loops, values=VALUES):
    """Return what the loop of this name sets, of 2 rows."""
    ratios = np.empty(2)
    loops.largest_ratios(2, 2, values, PRESSURES, np.array([2.0, 0.0]), ratios)
    return ratios


def test_no_number_stays_none():
    np.testing.assert_equal(largest_ratios(load(step_rows)), [1.5, math.nan])


def test_loops_without_rows_touch_nothing():
    none = np.empty((0, 2))
    load(step_rows).largest_ratios(0, 2, none, none, none, none)


@pytest.mark.parametrize(
    "values", [VALUES.astype(np.float32), VALUES.T, np.int64([[1, 2], [3, 4]])]
)
def test_arrays_of_other_types_or_orders_are_refused(values):
    with pytest.raises((TypeError, ValueError)):
        largest_ratios(load(step_rows), values)


def test_damaged_code_is_compiled_anew(tmp_path, monkeypatch):
    monkeypatch.setattr(machine_code, "_folders", lambda: [tmp_path])
    np.testing.assert_equal(largest_ratios(load.__wrapped__(step_rows)), [1.5, math.nan])
    (file,) = tmp_path.iterdir()
    damaged = file.read_bytes()[:-1] + b"?"
    file.write_bytes(damaged)
    np.testing.assert_equal(largest_ratios(load.__wrapped__(step_rows)), [1.5, math.nan])
    assert file.read_bytes() != damaged


def test_code_is_that_of_the_source_that_was_imported(tmp_path, monkeypatch):
    """Sources may change while a program runs that has not loaded its loops yet."""
    monkeypatch.setattr(machine_code, "_folders", lambda: [tmp_path])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # which is known by size and second
    source = tmp_path / "multiply.py"

    def imported(factor):
        source.write_text(
            "from ringwear_par.compiled.machine_code import Count, Reals\n"
            f"def multiply(n: Count, x: Reals):\n for i in range(n):\n  x[i] *= {factor}\n"
        )
        spec = importlib.util.spec_from_file_location("multiply", source)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    for module, factor in [(imported(2.0), 2.0), (imported(3.0), 3.0)]:
        load(module).multiply(1, value := np.ones(1))
        assert value == factor


@pytest.mark.parametrize("module", [contact_rows, step_rows], ids=lambda m: m.__name__)
def test_sums_are_in_loops_that_set_nothing(module):
    """Digits of others would depend on whether arrays might overlap, so on where they are."""
    for loop in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(loop, ast.For) and not any(isinstance(part, ast.For) for part in loop.body):
            parts = [*ast.walk(loop)]
            sums = {p.target.id for p in parts if isinstance(p, ast.AugAssign)
                    and isinstance(p.target, ast.Name)}  # fmt: skip
            sets = [p for p in parts if isinstance(p, ast.Subscript)
                    and isinstance(p.ctx, ast.Store)]  # fmt: skip
            assert not sums or not sets, (sums, loop.lineno)


def test_kept_code_is_loaded_without_the_compiler():
    load(step_rows)
    program = (
        "import sys; from ringwear_par.compiled import contact_rows, machine_code, step_rows; "
        "machine_code.load(step_rows); assert 'numba' not in sys.modules"
    )
    assert not python("-c", program).returncode
