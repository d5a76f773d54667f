"""Cholesky factors and solutions of small dense systems, eight histories at a time.

Matrices and vectors of a group of eight histories are interleaved, the history being the last
axis, so that each operation is one of vectors across histories: BLAS and LAPACK spend most of
their time elsewhere in matrices this small. What a history gets does not depend on the others in
its group. Numba's own loops over eight numbers do not keep them in registers: vectors of eight are
spelt out.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.compiling import compiled

#: histories of a group
GROUP = 8
#: rows that are eliminated at once; systems are padded to a multiple of it
PANEL = 8
#: right sides that are solved for at once, where there are several
COLUMNS = 4

_NUMBERS = ir.VectorType(ir.DoubleType(), GROUP)
_HALF = ir.VectorType(ir.DoubleType(), GROUP // 2)
_ADDRESS = ir.IntType(64)
_BYTES = 8 * GROUP  # of one entry of all eight


def _at(builder: Any, address: Any, entries: int) -> Any:
    if entries:
        address = builder.add(address, ir.Constant(_ADDRESS, _BYTES * entries))
    return builder.inttoptr(address, _NUMBERS.as_pointer())


def _load(builder: Any, address: Any, entries: int = 0) -> Any:
    return builder.load(_at(builder, address, entries), align=8)


def _store(builder: Any, value: Any, address: Any, entries: int = 0) -> None:
    builder.store(value, _at(builder, address, entries), align=8)


def _function(builder: Any, name: str, arguments: int, numbers: Any = _NUMBERS) -> Any:
    """Return one of LLVM's own functions of vectors."""
    known = builder.module.globals
    kind = ir.FunctionType(numbers, [numbers] * arguments)
    return known.get(name) or ir.Function(builder.module, kind, name)


def _less(builder: Any, value: Any, one: Any, other: Any) -> Any:
    """Return value - one * other, rounded once."""
    fused = _function(builder, "llvm.fma.v8f64", 3)
    return builder.call(fused, [builder.fneg(one), other, value])


@intrinsic
def _subtract(context: Any, to: Any, one: Any, other: Any) -> Any:
    """To -= one * other."""

    def generate(target: Any, builder: Any, signature: Any, a: Any) -> Any:
        loaded = (_load(builder, address) for address in a)
        _store(builder, _less(builder, *loaded), a[0])
        return target.get_dummy_value()

    return types.void(to, one, other), generate


@intrinsic
def _multiply(context: Any, to: Any, by: Any) -> Any:
    """To *= by."""

    def generate(target: Any, builder: Any, signature: Any, a: Any) -> Any:
        _store(builder, builder.fmul(_load(builder, a[0]), _load(builder, a[1])), a[0])
        return target.get_dummy_value()

    return types.void(to, by), generate


@intrinsic
def _inverse_root(context: Any, of: Any) -> Any:
    """Of = 1 / sqrt(of)."""

    def generate(target: Any, builder: Any, signature: Any, a: Any) -> Any:
        root = builder.call(_function(builder, "llvm.sqrt.v8f64", 1), [_load(builder, a[0])])
        _store(builder, builder.fdiv(ir.Constant(_NUMBERS, [1.0] * GROUP), root), a[0])
        return target.get_dummy_value()

    return types.void(of), generate


@intrinsic
def _eliminate(context: Any, to: Any, left: Any, right: Any, row: Any) -> Any:
    """Take from 2 x 2 entries at ``to`` what a panel makes there; a row is so many bytes."""

    def generate(target: Any, builder: Any, signature: Any, a: Any) -> Any:
        to, left, right, row = a
        rows = (to, builder.add(to, row))
        sums = [[_load(builder, at, j) for j in range(2)] for at in rows]
        for _ in range(PANEL):
            one = [_load(builder, left, i) for i in range(2)]
            other = [_load(builder, right, j) for j in range(2)]
            for i in range(2):
                for j in range(2):
                    sums[i][j] = _less(builder, sums[i][j], one[i], other[j])
            left, right = builder.add(left, row), builder.add(right, row)
        for i in range(2):
            for j in range(2):
                _store(builder, sums[i][j], rows[i], j)
        return target.get_dummy_value()

    return types.void(to, left, right, row), generate


@intrinsic
def _forward(context: Any, to: Any, known: Any, row: Any) -> Any:
    """Take from four entries what a known one makes of them."""

    def generate(target: Any, builder: Any, signature: Any, a: Any) -> Any:
        to, known, row = a
        x = _load(builder, known)
        for i in range(4):
            less = _less(builder, _load(builder, to, i), x, _load(builder, row, i))
            _store(builder, less, to, i)
        return target.get_dummy_value()

    return types.void(to, known, row), generate


@intrinsic
def _backward(context: Any, to: Any, known: Any, row: Any) -> Any:
    """Take from an entry what four known ones make of it."""

    def generate(target: Any, builder: Any, signature: Any, a: Any) -> Any:
        to, known, row = a
        x = _load(builder, to)
        for i in range(4):
            x = _less(builder, x, _load(builder, known, i), _load(builder, row, i))
        _store(builder, x, to)
        return target.get_dummy_value()

    return types.void(to, known, row), generate


@intrinsic
def _forward_rows(context: Any, to: Any, known: Any, row: Any, length: Any) -> Any:
    """Take from four entries what four known ones make of them; a row is so many bytes long."""

    def generate(target: Any, builder: Any, signature: Any, a: Any) -> Any:
        to, known, row, length = a
        sums = [_load(builder, to, j) for j in range(4)]
        for i in range(4):
            x = _load(builder, known, i)
            sums = [_less(builder, sums[j], x, _load(builder, row, j)) for j in range(4)]
            row = builder.add(row, length)
        for j in range(4):
            _store(builder, sums[j], to, j)
        return target.get_dummy_value()

    return types.void(to, known, row, length), generate


@intrinsic
def _backward_rows(context: Any, to: Any, known: Any, row: Any, length: Any) -> Any:
    """Take from four entries, of a row each, what four known ones make of them."""

    def generate(target: Any, builder: Any, signature: Any, a: Any) -> Any:
        to, known, row, length = a
        rows = [row]
        for _ in range(3):
            rows.append(builder.add(rows[-1], length))
        sums = [_load(builder, to, j) for j in range(4)]
        for i in range(4):
            x = _load(builder, known, i)
            sums = [_less(builder, sums[j], x, _load(builder, rows[j], i)) for j in range(4)]
        for j in range(4):
            _store(builder, sums[j], to, j)
        return target.get_dummy_value()

    return types.void(to, known, row, length), generate


def _half(builder: Any, half: int, address: Any, entries: int) -> Any:
    """Return where half of the histories' numbers of an entry are."""
    offset = ir.Constant(_ADDRESS, _BYTES * entries + _BYTES // 2 * half)
    return builder.inttoptr(builder.add(address, offset), _HALF.as_pointer())


def _take_known(builder: Any, to: list[Any], known: list[Any], row: Any) -> None:
    """Take from two entries of COLUMNS right sides what four known ones of each make of them.

    One half of the histories after the other, so that all sums stay in registers.

    Parameters
    ----------
    to, known : addresses of the entries of the first right side; the others' are next to it.
    row : of e and i, address of a row, and by which of its entries the e-th takes the i-th.
    """
    fused = _function(builder, "llvm.fma.v4f64", 3, _HALF)
    for half in range(2):
        places = [[_half(builder, half, entry, c) for c in range(COLUMNS)] for entry in to]
        sums = [[builder.load(place, align=8) for place in entry] for entry in places]
        for i in range(4):
            by = [
                builder.fneg(builder.load(_half(builder, half, *row(e, i)), align=8))
                for e in range(2)
            ]
            for c in range(COLUMNS):
                x = builder.load(_half(builder, half, known[i], c), align=8)
                for e in range(2):
                    sums[e][c] = builder.call(fused, [by[e], x, sums[e][c]])
        for entry, values in zip(places, sums, strict=True):
            for place, value in zip(entry, values, strict=True):
                builder.store(value, place, align=8)


def _following(builder: Any, first: Any, length: Any, count: int) -> list[Any]:
    """Return so many addresses, each so many bytes beyond the one before."""
    found = [first]
    for _ in range(count - 1):
        found.append(builder.add(found[-1], length))
    return found


def _entries(builder: Any, first: Any, count: int) -> list[Any]:
    """Return addresses of entries of COLUMNS right sides, one after another."""
    return _following(builder, first, ir.Constant(_ADDRESS, _BYTES * COLUMNS), count)


def _take_rows(builder: Any, arguments: Any, count: int, place: Any) -> None:
    """Do what an intrinsic below does, whose factor has so many rows, with its arguments.

    Parameters
    ----------
    place : returns row and column of the factor of the rows, an entry and a known one.
    """
    to, known, row, length = arguments
    rows = _following(builder, row, length, count)
    entries = _entries(builder, to, 2), _entries(builder, known, 4)
    _take_known(builder, *entries, lambda e, i: place(rows, e, i))


@intrinsic
def _forward_columns(context: Any, to: Any, known: Any, row: Any, length: Any) -> Any:
    """Take from two entries of COLUMNS right sides what four known ones, of a row each, make."""

    def generate(target: Any, builder: Any, signature: Any, a: Any) -> Any:
        _take_rows(builder, a, 4, lambda rows, e, i: (rows[i], e))
        return target.get_dummy_value()

    return types.void(to, known, row, length), generate


@intrinsic
def _backward_columns(context: Any, to: Any, known: Any, row: Any, length: Any) -> Any:
    """Take from two entries, of a row each, of COLUMNS right sides what four known ones make."""

    def generate(target: Any, builder: Any, signature: Any, a: Any) -> Any:
        _take_rows(builder, a, 2, lambda rows, e, i: (rows[e], i))
        return target.get_dummy_value()

    return types.void(to, known, row, length), generate


@compiled
def _range(free: BoolArray, group: int) -> tuple[int, int]:
    """Return between which rows elements of a group are free, by panels: others are unit rows."""
    n = free.shape[1]
    first, last = n, 0
    for k in range(GROUP * group, GROUP * group + GROUP):
        for i in range(first):
            if free[k, i]:
                first = i
                break
        for i in range(n - 1, last - 1, -1):
            if free[k, i]:
                last = i + 1
                break
    return first // PANEL * PANEL, -(-last // PANEL) * PANEL


@compiled
def _factor(u: FloatArray, first: int, last: int) -> None:
    """Factor eight interleaved matrices (n, n, 8), U'U, in place; diagonals are inverted.

    From a row to another: the rest is unit rows, which change nothing, not by a bit.
    """
    n = u.shape[0]
    base, row = u.ctypes.data, _BYTES * n
    for k in range(first, last, PANEL):
        for a in range(k, k + PANEL):
            here = base + a * row
            diagonal = here + _BYTES * a
            _inverse_root(diagonal)
            for j in range(a + 1, last):
                _multiply(here + _BYTES * j, diagonal)
            for c in range(a + 1, k + PANEL):
                there = base + c * row
                for j in range(c, last):
                    _subtract(there + _BYTES * j, here + _BYTES * c, here + _BYTES * j)
        panel = base + k * row
        for i in range(k + PANEL, last, 2):
            there = base + i * row
            for j in range(i, last, 2):
                _eliminate(there + _BYTES * j, panel + _BYTES * i, panel + _BYTES * j, row)


@compiled
def _substitute(u: FloatArray, x: FloatArray, first: int, last: int) -> None:
    """Solve eight interleaved systems with their factors, in place of right sides (n, 8)."""
    n = u.shape[0]
    base, row, at = u.ctypes.data, _BYTES * n, x.ctypes.data
    for k in range(first, last):
        here, known = base + k * row, at + _BYTES * k
        _multiply(known, here + _BYTES * k)
        j = k + 1
        while j % 4 != 0:
            _subtract(at + _BYTES * j, known, here + _BYTES * j)
            j += 1
        while j < last:
            _forward(at + _BYTES * j, known, here + _BYTES * j)
            j += 4
    for k in range(last - 1, first - 1, -1):
        here, unknown = base + k * row, at + _BYTES * k
        j = k + 1
        while j % 4 != 0:
            _subtract(unknown, at + _BYTES * j, here + _BYTES * j)
            j += 1
        while j < last:
            _backward(unknown, at + _BYTES * j, here + _BYTES * j)
            j += 4
        _multiply(unknown, here + _BYTES * k)


@compiled
def _substitute_rows(u: FloatArray, x: FloatArray, first: int, last: int) -> None:
    """Do as ``_substitute``, four rows at a time, to round-off: quicker where rows are near."""
    n = u.shape[0]
    base, row, at = u.ctypes.data, _BYTES * n, x.ctypes.data
    for k in range(first, last, 4):
        for a in range(k, k + 4):
            here, known = base + a * row, at + _BYTES * a
            _multiply(known, here + _BYTES * a)
            for j in range(a + 1, k + 4):
                _subtract(at + _BYTES * j, known, here + _BYTES * j)
        for j in range(k + 4, last, 4):
            _forward_rows(at + _BYTES * j, at + _BYTES * k, base + k * row + _BYTES * j, row)
    for k in range(last - 4, first - 1, -4):
        for j in range(k + 4, last, 4):
            _backward_rows(at + _BYTES * k, at + _BYTES * j, base + k * row + _BYTES * j, row)
        for a in range(k + 3, k - 1, -1):
            here, unknown = base + a * row, at + _BYTES * a
            for j in range(a + 1, k + 4):
                _subtract(unknown, at + _BYTES * j, here + _BYTES * j)
            _multiply(unknown, here + _BYTES * a)


@compiled
def _substitute_columns(u: FloatArray, x: FloatArray, first: int, last: int) -> None:
    """Do as ``_substitute_rows`` for COLUMNS right sides at once, (n, COLUMNS, 8)."""
    n = u.shape[0]
    base, row, at, size = u.ctypes.data, _BYTES * n, x.ctypes.data, _BYTES * COLUMNS
    for k in range(first, last, 4):
        for a in range(k, k + 4):
            here = base + a * row
            for c in range(COLUMNS):
                column = at + _BYTES * c
                known = column + size * a
                _multiply(known, here + _BYTES * a)
                for j in range(a + 1, k + 4):
                    _subtract(column + size * j, known, here + _BYTES * j)
        for j in range(k + 4, last, 2):
            _forward_columns(at + size * j, at + size * k, base + k * row + _BYTES * j, row)
    for k in range(last - 4, first - 1, -4):
        for j in range(k + 4, last, 4):
            for a in range(k, k + 4, 2):
                _backward_columns(at + size * a, at + size * j, base + a * row + _BYTES * j, row)
        for a in range(k + 3, k - 1, -1):
            here = base + a * row
            for c in range(COLUMNS):
                column = at + _BYTES * c
                unknown = column + size * a
                for j in range(a + 1, k + 4):
                    _subtract(unknown, column + size * j, here + _BYTES * j)
                _multiply(unknown, here + _BYTES * a)


@compiled
def factor(
    groups: IntArray,
    matrices: FloatArray,
    which: IntArray,
    slope: FloatArray,
    free: BoolArray,
    coupling: FloatArray,
    factors: FloatArray,
) -> None:
    """Factor the Hessians of all histories of some groups, on the elements that are free.

    Parameters
    ----------
    groups : (g,) int.
    matrices : (m, n, n) float, scaled compliances.
    which : (B,) int, the matrix of each history.
    slope : (B, n) float, what wear adds to the diagonal.
    free : (B, n) bool.
    coupling : (B, n, n) float, what non-local wear adds; (0, n, n) where it is local.
    factors : (B / 8, n', n', 8) float, n' being n padded; those of the groups are replaced, as far
        as there are free elements.
    """
    n = matrices.shape[1]
    coupled = coupling.shape[0] > 0
    mask = np.empty((n, GROUP))
    for group in groups:
        u, first = factors[group], GROUP * group
        one, same, all_free = which[first], True, True
        for k in range(GROUP):
            same = same and which[first + k] == one
            for i in range(n):
                inside = free[first + k, i]
                mask[i, k] = 1.0 if inside else 0.0
                all_free = all_free and inside
        start, stop = _range(free, group)
        end = min(stop, n)
        for i in range(start, end):
            for j in range(i, end):
                if same:
                    value = matrices[one, i, j]
                    for k in range(GROUP):
                        u[i, j, k] = value
                else:
                    for k in range(GROUP):
                        u[i, j, k] = matrices[which[first + k], i, j]
                if coupled:
                    for k in range(GROUP):
                        u[i, j, k] += coupling[first + k, i, j]
                if not all_free:
                    for k in range(GROUP):
                        u[i, j, k] *= mask[i, k] * mask[j, k]
            for j in range(n, stop):
                for k in range(GROUP):
                    u[i, j, k] = 0.0
            for k in range(GROUP):
                if free[first + k, i]:
                    u[i, i, k] += slope[first + k, i]
                else:
                    u[i, i, k] = 1.0
        for i in range(n, stop):
            for j in range(i, stop):
                for k in range(GROUP):
                    u[i, j, k] = 1.0 if i == j else 0.0
        _factor(u, start, stop)


@compiled
def solve(
    histories: IntArray,
    free: BoolArray,
    factors: FloatArray,
    right: FloatArray,
    out: FloatArray,
) -> None:
    """Solve the systems of some histories on the elements that are free; 0 elsewhere.

    Parameters
    ----------
    histories : (h,) int, increasing.
    free : (B, n) bool, those that were factored, or some of them.
    factors : of ``factor``.
    right : (h, n) float.
    out : (h, n) float, the solutions.
    """
    n, padded, count = free.shape[1], factors.shape[1], len(histories)
    x = np.zeros((padded, GROUP))
    first = 0
    while first < count:
        group, last = histories[first] // GROUP, first
        while last < count and histories[last] // GROUP == group:
            last += 1
        x[:] = 0.0
        for place in range(first, last):
            history = histories[place]
            for i in range(n):
                if free[history, i]:
                    x[i, history % GROUP] = right[place, i]
        start, stop = _range(free, group)
        _substitute(factors[group], x, start, stop)
        for place in range(first, last):
            history = histories[place]
            for i in range(n):
                out[place, i] = x[i, history % GROUP] if free[history, i] else 0.0
        first = last


@compiled
def solve_more(
    histories: IntArray,
    free: BoolArray,
    factors: FloatArray,
    right: FloatArray,
    out: FloatArray,
) -> None:
    """Solve as ``solve`` does for (k, h, n) right sides: to round-off, some at once."""
    n, padded, count, sides = free.shape[1], factors.shape[1], len(histories), right.shape[0]
    x, alone = np.zeros((padded, COLUMNS, GROUP)), np.zeros((padded, GROUP))
    first = 0
    while first < count:
        group, last = histories[first] // GROUP, first
        while last < count and histories[last] // GROUP == group:
            last += 1
        start, stop = _range(free, group)
        for k in range(0, sides, COLUMNS):
            columns = min(COLUMNS, sides - k)
            x[:] = 0.0
            for c in range(columns):
                for place in range(first, last):
                    history = histories[place]
                    for i in range(n):
                        if free[history, i]:
                            x[i, c, history % GROUP] = right[k + c, place, i]
            if columns > 1:
                _substitute_columns(factors[group], x, start, stop)
            else:
                alone[:] = x[:, 0]
                _substitute_rows(factors[group], alone, start, stop)
                x[:, 0] = alone
            for c in range(columns):
                for place in range(first, last):
                    history = histories[place]
                    for i in range(n):
                        out[k + c, place, i] = x[i, c, history % GROUP] if free[history, i] else 0.0
        first = last


@compiled(fastmath={"contract"})
def multiply(
    histories: IntArray, matrices: FloatArray, which: IntArray, x: FloatArray, out: FloatArray
) -> None:
    """Set ``out[h] = matrices[which[h]]' x[h]`` for some histories; the others' rows stay.

    Parameters
    ----------
    histories : (h,) int.
    matrices : (m, n, n) float.
    which : (B,) int.
    x, out : (B, n) float.
    """
    n = x.shape[1]
    whole = n - n % 4
    for history in histories:
        matrix, to, by = matrices[which[history]], out[history], x[history]
        for i in range(n):
            to[i] = 0.0
        for j in range(0, whole, 4):
            a, b, c, d = by[j], by[j + 1], by[j + 2], by[j + 3]
            for i in range(n):
                to[i] += (
                    matrix[j, i] * a + matrix[j + 1, i] * b
                    + matrix[j + 2, i] * c + matrix[j + 3, i] * d
                )  # fmt: skip
        for j in range(whole, n):
            a = by[j]
            for i in range(n):
                to[i] += matrix[j, i] * a


@compiled(fastmath={"contract"})
def multiply_more(
    histories: IntArray, matrices: FloatArray, which: IntArray, x: FloatArray, out: FloatArray
) -> None:
    """Multiply as ``multiply`` does for (k, B, n): two at once, as matrices take long to fetch."""
    sides, n = x.shape[0], x.shape[2]
    whole = n - n % 4
    to, to_too = np.empty(n), np.empty(n)
    for history in histories:
        matrix = matrices[which[history]]
        for k in range(0, sides - 1, 2):
            by, by_too = x[k, history], x[k + 1, history]
            to[:] = 0.0
            to_too[:] = 0.0
            for j in range(0, whole, 4):
                a, b, c, d = by[j], by[j + 1], by[j + 2], by[j + 3]
                e, f, g, h = by_too[j], by_too[j + 1], by_too[j + 2], by_too[j + 3]
                for i in range(n):
                    p, q, r, s = matrix[j, i], matrix[j + 1, i], matrix[j + 2, i], matrix[j + 3, i]
                    to[i] += p * a + q * b + r * c + s * d
                    to_too[i] += p * e + q * f + r * g + s * h
            for j in range(whole, n):
                for i in range(n):
                    to[i] += matrix[j, i] * by[j]
                    to_too[i] += matrix[j, i] * by_too[j]
            out[k, history] = to
            out[k + 1, history] = to_too
    if sides % 2 != 0:
        multiply(histories, matrices, which, x[sides - 1], out[sides - 1])
