"""A case that is changed number by number: its histories, its text for saving."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.keys import in_full
from ringwear_par.cases.files.reading import make_case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.explorer.controls import Control, controls_of
from ringwear_par.explorer.moved_keys import changed_keys
from ringwear_par.files.text import toml_text
from ringwear_par.history.elastic import assemble, operator_key
from ringwear_par.history.loop import Instant, simulate_one
from ringwear_par.history.refusals import check_case
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import Result

#: about how many states of fixed steps are kept: more would not be seen
_STATES = 400


@dataclass(frozen=True, eq=False)
class Explored:
    """A history of some numbers."""

    #: the case file
    text: str
    #: as the file has it
    case: Case
    #: as they stand, by name
    controls: Mapping[str, Control]
    #: ``rw.simulate`` of the case, with all fields, and nearly all steps or its times
    result: Result


class Exploration:
    """A case file whose numbers are moved; what is assembled is used as long as it fits.

    Parameters
    ----------
    keys : raw keys, see ``moved_keys.raw_keys``.
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
        stops: Callable[[float], bool] = lambda fraction: False,
    ) -> Explored | None:
        """Return the history of other numbers; None: it was stopped.

        Parameters
        ----------
        texts : by the names of controls, perhaps with units.
        assembling : called before bodies are assembled.
        stops : called after every step with the fraction of the time that is done; whether to stop.

        Raises
        ------
        InputError : all that is wrong with the numbers, one sentence each.
        ComputationError : a step failed.
        """
        keys, controls = changed_keys(self._keys, self.controls, texts)
        case = make_case(in_full(keys, Path()), self._name)
        check_case(case, 1, self._name)
        drawn = make_case(in_full(_stored(keys, case), Path()), self._name)
        pair = None
        if not drawn.follows_wear:  # of which each history assembles anew
            if self._pair is None or self._pair.key != operator_key(drawn):
                assembling()
                self._pair = assemble(drawn, self._comm)
            pair = self._pair
        stopped = False

        recorder = Recorder([drawn], self._comm, pair_is_shared=pair is not None)

        def save(instant: Instant) -> bool:
            nonlocal stopped
            recorder(instant)
            done = float(instant.state.time[0]) / drawn.time.end
            stopped = not instant.ended[0] and stops(done)
            return stopped

        simulate_one(drawn, self._comm, save, pair=pair, every=True)
        if stopped:
            return None
        return Explored(toml_text(keys), case, controls, recorder.result())


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
