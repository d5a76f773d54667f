"""Loops that are compiled ahead: where their code is kept, and what they refuse."""

import ast
import importlib.util
import inspect
import math
import sys

import numpy as np
import pytest
from commands import python

from ringwear_par.compiled import error_rows, machine_code
from ringwear_par.compiled.machine_code import load
from ringwear_par.compiled.modules import LOOPS

VALUES, PRESSURES = np.array([[1.0, -3.0], [math.nan, 1.0]]), np.array([[1.0, 2.0], [4.0, 2.0]])


def largest_ratios(loops, values=VALUES):
    """Return what the loop of this name sets, of 2 rows."""
    ratios = np.empty(2)
    loops.largest_ratios(2, 2, values, PRESSURES, np.array([2.0, 0.0]), ratios)
    return ratios


def test_no_number_stays_none():
    np.testing.assert_equal(largest_ratios(load(error_rows)), [1.5, math.nan])


def test_loops_without_rows_touch_nothing():
    none = np.empty((0, 2))
    load(error_rows).largest_ratios(0, 2, none, none, none, none)


@pytest.mark.parametrize(
    "values", [VALUES.astype(np.float32), VALUES.T, np.int64([[1, 2], [3, 4]])]
)
def test_arrays_of_other_types_or_orders_are_refused(values):
    with pytest.raises((TypeError, ValueError)):
        largest_ratios(load(error_rows), values)


def test_damaged_code_is_compiled_anew(tmp_path, monkeypatch):
    monkeypatch.setattr(machine_code, "_folders", lambda: [tmp_path])
    np.testing.assert_equal(largest_ratios(load.__wrapped__(error_rows)), [1.5, math.nan])
    (file,) = tmp_path.iterdir()
    damaged = file.read_bytes()[:-1] + b"?"
    file.write_bytes(damaged)
    np.testing.assert_equal(largest_ratios(load.__wrapped__(error_rows)), [1.5, math.nan])
    assert file.read_bytes() != damaged


@pytest.fixture
def imported(tmp_path, monkeypatch):
    """Import a module of loops from its text, whose code nobody has compiled."""
    monkeypatch.setattr(machine_code, "_folders", lambda: [tmp_path])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # which is known by size and second

    def import_text(text):
        source = tmp_path / "multiply.py"
        source.write_text(text)
        spec = importlib.util.spec_from_file_location("multiply", source)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return import_text


def test_code_is_that_of_the_source_that_was_imported(imported):
    """Sources may change while a program runs that has not loaded its loops yet."""
    text = (
        "from ringwear_par.compiled.machine_code import Count, Reals\n"
        "def multiply(n: Count, x: Reals):\n for i in range(n):\n  x[i] *= {}\n"
    )
    modules = [imported(text.format(factor)) for factor in (2.0, 3.0)]
    for module, factor in zip(modules, (2.0, 3.0), strict=True):
        load(module).multiply(1, value := np.ones(1))
        assert value == factor


@pytest.mark.parametrize("fields", ["x: Reals; factor: Real", "factor: Real; x: Reals"])
def test_records_are_their_fields_and_parts_belong_to_loops(imported, fields):
    """In loops and parts, of records within records; the code is known by what fields there are."""
    module = imported(
        "from typing import NamedTuple\n"
        "from ringwear_par.compiled.machine_code import Count, Real, Reals, part\n"
        f"class Factor(NamedTuple): {fields}\n"
        "class Both(NamedTuple): factor: Factor; y: Reals\n"
        "@part\n"
        "def multiply_one(i: Count, both: Both):\n"
        " both.y[i] = both.factor.x[i] * both.factor.factor\n"
        "def multiply(n: Count, both: Both):\n for i in range(n):\n  multiply_one(i, both)\n"
    )
    loops, y = load(module), np.zeros(2)
    assert not hasattr(loops, "multiply_one")
    for factor in (2.0, 3.0):
        loops.multiply(2, module.Both(module.Factor(x=np.arange(2.0), factor=factor), y))
        assert y.tolist() == [0.0, factor]


@pytest.mark.parametrize("module", LOOPS, ids=lambda m: m.__name__)
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
    load(error_rows)
    program = (
        "import sys; from ringwear_par.compiled import error_rows, machine_code; "
        "machine_code.load(error_rows); assert 'numba' not in sys.modules"
    )
    assert not python("-c", program).returncode
