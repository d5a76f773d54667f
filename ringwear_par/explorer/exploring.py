"""A case that is changed number by number: its keys, its text to take home, its histories."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.keys import flatten, in_full, override, parse_overrides, read_keys
from ringwear_par.cases.files.reading import make_case, read_case
from ringwear_par.cases.layers import changed_layers, expanded
from ringwear_par.cases.text import toml_text
from ringwear_par.cases.units import has_unit, in_unit, is_plain, number_and_unit
from ringwear_par.cases.values import RejectedError
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import InputError, legible
from ringwear_par.explorer.controls import controls_of
from ringwear_par.explorer.sliders import Control
from ringwear_par.files.text import read_text
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.history.validity.case_limits import check_case
from ringwear_par.results.execution.recorder import Recorder
from ringwear_par.results.result import Result

#: about how many states of fixed steps are kept: more would not be seen
_STATES = 400
#: tolerances of sketches over those of a case: of ten of scripts/cases they took a sixth to nearly
#: all of the time, and their penetrations were off by 1e-3 at most
_COARSER, _ROUGHER = 10.0, 5.0
_PROFILES = ("lower.profile", "upper.profile")
_FILES = ("wear.lower.file", "wear.upper.file", *(f"{table}.file" for table in _PROFILES))


@dataclass(frozen=True, eq=False)
class Explored:
    """A history of some numbers.

    Parameters
    ----------
    text : the case file.
    case : as the file has it.
    controls : as they stand, by name.
    result : ``rw.simulate`` of the case, with all fields, and nearly all steps or its times.
    """

    text: str
    case: Case
    controls: Mapping[str, Control]
    result: Result


class Exploration:
    """A case file whose numbers are moved; what is assembled is used as long as it fits.

    Parameters
    ----------
    keys : raw keys, see ``raw_keys``.
    name : what messages call the case.
    comm : communicator of one rank.
    """

    def __init__(self, keys: Mapping[str, Any], name: str, comm: MPI.Comm) -> None:
        self._keys, self._name, self._comm = keys, name, comm
        self.title = str(keys.get("title", ""))
        self.layered = any(keys.get(f"{body}.layers") for body in ("lower", "upper"))
        #: of the case file, in the order of the page
        self.controls = {control.name: control for control in controls_of(keys)}
        self._pair: ContactPair | None = None

    def compute(
        self,
        texts: Mapping[str, str],
        assembling: Callable[[], None] = lambda: None,
        *,
        sketch: bool = False,
        stops: Callable[[float], bool] = lambda share: False,
    ) -> Explored | None:
        """Return the history of other numbers; None: it was stopped.

        Parameters
        ----------
        texts : by the names of controls, perhaps with units.
        assembling : called before bodies are assembled.
        sketch : whether coarser steps will do.
        stops : called after every step with the share of the time that is done; whether to stop.

        Raises
        ------
        InputError : all that is wrong with the numbers, one sentence each.
        ComputationError : a step failed.
        """
        keys, controls = changed_keys(self._keys, self.controls, texts)
        case = make_case(in_full(keys, Path()), self._name)
        check_case(case, 1, self._name)
        stored = _stored(keys, case)
        if sketch:
            stored = override(stored, _coarse(case))
        drawn = make_case(in_full(stored, Path()), self._name)
        pair = None
        if not drawn.follows_wear:  # of which each history assembles anew
            if self._pair is None or self._pair.key != operator_key(drawn):
                assembling()
                self._pair = assemble(drawn, self._comm)
            pair = self._pair
        stopped = False

        def observe(snapshot: Snapshot) -> bool:
            nonlocal stopped
            done = float(snapshot.state.time[0]) / drawn.time.end
            stopped = not snapshot.finished[0] and stops(done)
            return stopped

        recorder = Recorder([drawn], self._comm)
        simulate_one(drawn, self._comm, pair=pair, observers=[recorder, observe])
        if stopped:
            return None
        return Explored(toml_text(keys), case, controls, recorder.result())


def raw_keys(path: Path, overrides: list[str]) -> dict[str, Any]:
    """Return the dotted keys of a case file as the user wrote them, names of files in full.

    Raises
    ------
    InputError : what ``ringwear run`` refuses, in its words.
    """
    check_case(read_case(path, overrides), 1, str(path))
    of_file = _files_in_full(read_keys(read_text(path), str(path)), path.parent)
    changes = flatten(parse_overrides(overrides), "--set")
    return override(of_file, _files_in_full(changes, Path()))


def _files_in_full(keys: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return keys with the whole names of files, so that the text may be saved anywhere."""
    full = dict(keys)
    for path, value in keys.items():
        if path in _FILES:
            full[path] = str((folder / value).resolve())
        elif path in _PROFILES and isinstance(value, Mapping) and "file" in value:
            full[path] = {"file": str((folder / value["file"]).resolve())}
    return full


def _stored(keys: Mapping[str, Any], case: Case) -> dict[str, Any]:
    """Return keys that have stored what the page draws of a history.

    Times of output stay: states between steps change what comes after them in the last digits.
    """
    replaced = {"output.every", "output.fields", "output.profiles", "output.boundary"}
    stored = {
        path: value
        for path, value in keys.items()
        if path not in replaced and not path.startswith("stress.")
    }
    if not case.output.times:
        stored["output.every"] = 1 if case.time.adaptive else max(1, case.time.steps // _STATES)
    return stored


def _coarse(case: Case) -> dict[str, Any]:
    """Return the keys of coarser steps than those of a case."""
    return {
        "time.scheme": "adaptive",
        "time.tolerance": _COARSER * case.time.tolerance,
        "time.pressure_tolerance": _ROUGHER * case.time.pressure_tolerance,
        **({} if case.output.times else {"output.every": 1}),
    }


def changed_keys(
    keys: Mapping[str, Any], controls: Mapping[str, Control], texts: Mapping[str, str]
) -> tuple[dict[str, Any], dict[str, Control]]:
    """Return keys with other numbers, and the controls as they then stand.

    Parameters
    ----------
    keys : raw ones.
    controls : of these keys, by name.
    texts : numbers by the names of controls, perhaps with units, as in a case file.

    Raises
    ------
    InputError : all texts that are no numbers.
    """
    raw_keys, changes, moved, faults = expanded(keys), dict[str, Any](), dict(controls), []
    for name, text in texts.items():
        control = controls.get(name)
        if control is None:
            faults.append(f"{legible(name)}: is no number of this case that can be moved")
            continue
        try:
            raw, value = _read(control, text)
        except RejectedError as reason:
            cause = f" ({reason})" if str(reason) else ""
            unit = f" in {control.unit}" if control.unit else ""
            unit += ", or one with its unit" if control.unit and not control.scales else ""
            faults.append(
                f"{control.name} = {legible(text) or '(empty)'}: must be a number{unit}{cause}"
            )
            continue
        moved[name] = control.at(value)
        changes[control.path] = _put(
            control, changes.get(control.path, raw_keys.get(control.path)), raw
        )
    if faults:
        raise InputError(*faults)
    return {**keys, **changed_layers(keys, changes)}, moved


def _read(control: Control, text: str) -> tuple[Any, float]:
    """Return the raw value of a text, and its number in the unit of the control."""
    text = text.strip().replace("\N{MINUS SIGN}", "-")
    if is_plain(text):
        value = float(text)
        if not math.isfinite(value):
            raise RejectedError
        if control.whole and value.is_integer() and abs(value) < 1e15:
            return int(value), value
        return (f"{text} {control.unit}" if control.written else value), value
    if control.scales or not has_unit(text) or not control.unit:
        raise RejectedError
    return text, float(in_unit(text, control.unit))


def _put(control: Control, before: Any, raw: Any) -> Any:
    """Return the raw value of a key with that of a control in it."""
    if control.scales:
        if isinstance(control.entry, str):
            return {**before, control.entry: _scaled(before[control.entry], raw)}
        return _scaled(before, raw)
    if isinstance(control.entry, int):
        entries = list(before)
        entries[control.entry] = raw
        return entries
    if isinstance(control.entry, str):
        shape, _, place = control.entry.partition("[")
        if place:  # one of the two fillets
            entries = list(before[shape])
            entries[int(place[:-1])] = raw
            return {**before, shape: entries}
        return {**before, control.entry: raw}
    return raw


def _scaled(table: Any, times: float) -> Any:
    """Return a table [[x, value], ...], or { r = such a table }, its values multiplied."""
    if isinstance(table, Mapping):
        return {axis: _scaled(points, times) for axis, points in table.items()}
    return [[x, _times_as_much(value, times)] for x, value in table]


def _times_as_much(value: Any, times: float) -> Any:
    if times == 1.0:
        return value
    if isinstance(value, str):  # with a unit
        number, unit = number_and_unit(value)
        return f"{number * times:.12g} {unit}"
    return float(f"{value * times:.12g}")
