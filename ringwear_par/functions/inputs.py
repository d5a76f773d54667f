"""The inputs of a function: numbers of a case, and the cases that differ in them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.keys import override, read_keys
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.layers import LAYERS
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
            unit = unit_under(name, self._laws) or "1"
            schema[name] = {"unit": unit, "bounds": bounds, "meaning": key.meaning, "value": value}
        return schema

    def _laws(self, key: str) -> list[Any]:
        return [variations.value_of(self.keys, key)]

    def case(self, row: Sequence[float]) -> Case:
        """Return the case with other numbers.

        Raises
        ------
        InputError : all its faults.
        """
        keys = variations.varied_keys(
            self.keys, [variations.split_key(name) for name in self.names], row
        )
        return make_case(keys, "case")

    def rows(self, values: Mapping[str, Any]) -> tuple[list[tuple[float, ...]], tuple[int, ...]]:
        """Return the numbers of each case, and the shape that all inputs are broadcast to.

        Parameters
        ----------
        values : of all names: numbers, texts with a unit, or arrays of them.

        Raises
        ------
        InputError : all faults but those of single cases.
        """
        try:
            values = dict(values)  # of a table of pandas its columns
        except (TypeError, ValueError) as error:
            raise InputError(
                f"function: {shortened(values)}: must be a dict of {', '.join(self.names)}"
            ) from error
        faults: list[str] = []
        name_unknown_keys("function", map(str, values), self.names, faults)
        faults += [f"function: {name}: is missing" for name in self.names if name not in values]
        arrays = [_numbers(name, values[name], faults) for name in self.names if name in values]
        if faults:
            raise InputError(*faults)
        try:
            shape = np.broadcast_shapes(*(array.shape for array in arrays))
        except ValueError as error:
            sizes = ", ".join(f"{n} {a.shape}" for n, a in zip(self.names, arrays, strict=True))
            raise InputError(
                f"function: shapes {sizes}: must be numbers, or arrays that broadcast together"
            ) from error
        columns = [np.broadcast_to(array, shape).ravel().tolist() for array in arrays]
        return list(zip(*columns, strict=True)), shape


def _numbers(name: str, value: Any, faults: list[str]) -> Any:
    """Return an input as an array of numbers in the case's unit, and add its faults."""
    raw = np.asarray(value, dtype=object)
    numbers = np.empty(raw.shape, dtype=object)
    for place, entry in np.ndenumerate(raw):
        entry = entry.item() if isinstance(entry, np.generic) else entry
        reason = ""
        try:
            numbers[place] = _without_unit(name, entry) if isinstance(entry, str) else entry
        except RejectedError as error:
            reason = f" ({error})" if str(error) else ""
        if not is_number(numbers[place]):
            unit = f" ({unit_of(name)})" if unit_of(name) else ""
            faults.append(
                f"function: {name} = {shortened(entry)}: must be a number, or an array of "
                f"numbers{unit}{reason}"
            )
            break
    return numbers


def _without_unit(name: str, text: str) -> Any:
    path, entry = variations.split_key(name)
    table = entry if isinstance(entry, str) and path not in LAYERS else None
    return variations.own_key(name).without_units(text, table)


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
    faults = list(_name_faults(case, keys, names))
    if faults:
        raise InputError(*(f"function: inputs: {fault}" for fault in faults))
    values = tuple(float(_value(case, keys, name)) for name in names)
    inputs = CaseInputs(override(keys, changes), tuple(names), values)
    inputs.case(values)
    return inputs


def _name_faults(case: Case, keys: Mapping[str, Any], names: Sequence[str]) -> Iterator[str]:
    for place, name in enumerate(names):
        if fault := variations.name_fault(legible(name), name, name):
            yield fault
            continue
        value = _value(case, keys, name)
        if name in names[:place]:
            yield f"{name}: must be named once"
        elif value is None:
            yield f"{legible(name)}: is not in the case; must be a number of it"
        elif not is_number(value):
            yield f"{name} = {shortened(value)}: must be a number in the case"


def _value(case: Case, keys: Mapping[str, Any], name: str) -> Any:
    """Return the value of a key in a case, of a force as its pressure too; None for none."""
    force: Any = case.load.force
    if is_number(force):
        keys = {"load.force": force, "load.pressure": force / case.area, **keys}
    return variations.value_of(keys, name)
