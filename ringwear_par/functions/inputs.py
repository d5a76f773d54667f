"""The inputs of a function: numbers of a case, and the cases that differ in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.keys import override, read_keys
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.schema import unit_of, unit_under
from ringwear_par.cases.tables import name_unknown_keys
from ringwear_par.cases.values import RejectedError, is_number
from ringwear_par.errors import InputError, legible
from ringwear_par.files.text import shortened
from ringwear_par.studies import variations


@dataclass(frozen=True)
class CaseInputs:
    """Numbers of a case that functions vary."""

    #: dotted keys and raw values of the base case
    keys: Mapping[str, Any]
    #: keys of the numbers, as sweeps name them
    names: tuple[str, ...]
    #: in the base case
    values: tuple[float, ...]

    def schema(self) -> dict[str, dict[str, Any]]:
        """Return unit, bounds (None: none), meaning and value in the base case of each."""
        schema = {}
        for name, value in zip(self.names, self.values, strict=True):
            key = variations.own_key(name)
            ends = (None, None) if key.numbers is None else (key.numbers.low, key.numbers.high)
            bounds = [None if end is None or np.isinf(end) else end for end in ends]
            unit = unit_under(name, lambda key: [variations.value_of(self.keys, key)]) or "1"
            schema[name] = {"unit": unit, "bounds": bounds, "meaning": key.meaning, "value": value}
        return schema

    def case(self, row: Sequence[float]) -> Case | InputError:
        """Return the case with other numbers, or all its faults."""
        parts = [variations.split_key(name) for name in self.names]
        try:
            return make_case(variations.varied_keys(self.keys, parts, row), "case")
        except InputError as error:
            return error

    def rows(self, values: Mapping[str, Any]) -> tuple[list[tuple[float, ...]], tuple[int, ...]]:
        """Return the numbers of each case, and the shape that all inputs are broadcast to.

        Parameters
        ----------
        values : of all names: numbers, texts with a unit, or arrays of them.

        Raises
        ------
        InputError : all faults but those of single cases.
        ValueError : arrays that do not broadcast together.
        """
        values = dict(values)  # of a table of pandas its columns
        faults: list[str] = []
        name_unknown_keys("function", map(str, values), self.names, faults)
        faults += [f"function: {name}: is missing" for name in self.names if name not in values]
        if faults:
            raise InputError(*faults)
        arrays = np.broadcast_arrays(*(_numbers(name, values[name]) for name in self.names))
        rows = zip(*(array.ravel().tolist() for array in arrays), strict=True)
        return list(rows), arrays[0].shape


def _numbers(name: str, value: Any) -> Any:
    """Return an input as an array of numbers in the case's unit."""
    raw = np.asarray(value, dtype=object)
    numbers = np.empty(raw.shape, dtype=object)
    for place, entry in np.ndenumerate(raw):
        entry, reason = entry.item() if isinstance(entry, np.generic) else entry, ""
        try:
            numbers[place] = variations.without_units(name, entry)
        except RejectedError as error:
            reason = f" ({error})"
        if not is_number(numbers[place]):
            unit = f" ({unit_of(name)})" if unit_of(name) else ""
            raise InputError(
                f"function: {name} = {shortened(entry)}: must be a number, or an array of "
                f"numbers{unit}{reason}"
            )
    return numbers


def case_inputs(case: Case, names: Sequence[str], changes: Mapping[str, Any]) -> CaseInputs:
    """Return the inputs of a function. Not collective.

    Parameters
    ----------
    changes : of keys of the case, in all cases.

    Raises
    ------
    InputError : names that are no numbers of the case; changes that the case does not allow.
    """
    case = case.replace({})  # refused where its text does not tell its keys
    keys = read_keys(case.text)
    if isinstance(names, str) or not names or not all(isinstance(name, str) for name in names):
        raise InputError(
            f"function: inputs = {shortened(names)}: must be a list of keys, as ['wear.lower.k']"
        )
    faults: list[str] = []
    for name in names:
        if fault := variations.name_fault(legible(name), name, name):
            faults.append(f"function: inputs: {fault}")
        elif not is_number(value := _value(case, keys, name)):
            state = "is not in it" if value is None else f"= {shortened(value)}"
            faults.append(f"function: inputs: {name} {state}: must be a number in the case")
    if faults:
        raise InputError(*faults)
    values = tuple(float(_value(case, keys, name)) for name in names)
    inputs = CaseInputs(override(keys, changes), tuple(names), values)
    if isinstance(error := inputs.case(values), InputError):
        raise error
    return inputs


def _value(case: Case, keys: Mapping[str, Any], name: str) -> Any:
    """Return the value of a key in a case, of a force as its pressure too; None for none."""
    force: Any = case.load.force
    if is_number(force):
        keys = {"load.force": force, "load.pressure": force / case.area, **keys}
    return variations.value_of(keys, name)
