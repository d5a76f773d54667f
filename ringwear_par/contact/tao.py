"""A TAO's life: what its callbacks raise, and its end before that of PETSc."""

import atexit
import traceback
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

from ringwear_par.errors import ComputationError
from ringwear_par.petsc import PETSc


class Guard:
    """Keeps what callbacks raise until their TAO has ended.

    After an error PETSc is in no state to go on, and passes on another than was raised.

    Parameters
    ----------
    alone : whether no other rank waits in the callbacks.
    """

    def __init__(self, alone: bool = True) -> None:
        self._alone = alone
        self._failure: BaseException | None = None

    def guarded(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Return a callback that keeps what it raises, and has the TAO end."""

        def guarded(tao: PETSc.TAO, *args: Any) -> Any:
            if self._failure is None:
                try:
                    return callback(tao, *args)
                except BaseException as error:
                    self._failure = error
                    if not (self._alone or isinstance(error, Exception)):
                        raise  # a signal to this rank: others may wait for it in here
            tao.setConvergedReason(PETSc.TAO.Reason.DIVERGED_USER)
            return 0.0

        return guarded

    def solve(self, tao: PETSc.TAO, name: str) -> None:
        """Solve the problem posed; raise what a callback raised as it was.

        Parameters
        ----------
        name : of the TAO, for the sentence.
        """
        failures: list[BaseException] = []
        tao.setConvergedReason(PETSc.TAO.Reason.CONTINUE_ITERATING)
        try:
            tao.solve()
        except BaseException as error:
            failures.append(error)
            # petsc4py from 3.19 on wraps what our own solver raised
            while isinstance(failures[-1], PETSc.Error) and failures[-1].__cause__ is not None:
                failures.append(failures[-1].__cause__)
        if self._failure is not None:
            failures.append(self._failure)
            self._failure = None
        if not failures:
            return
        # what callbacks hold are references of their own to the TAO, which must not
        # outlive it: an exception keeps the frames that it came through
        for failure in failures:
            traceback.clear_frames(failure.__traceback__)
        try:
            if isinstance(failure, PETSc.Error):
                raise ComputationError(
                    f"contact: TAO {name} failed (PETSc error {failure.ierr})"
                ) from failure
            raise failure
        finally:
            del failure, failures  # no cycle by way of this frame


#: solvers whose PETSc objects are alive, in the order of their making, which ranks share
OPEN: WeakKeyDictionary[Any, None] = WeakKeyDictionary()


def _destroy_open() -> None:
    """Free what is left at the end of the process: a TAO must not outlive PETSc.

    Registered after petsc4py's own ending, so called before it.
    """
    for solver in list(OPEN):
        solver.destroy()


atexit.register(_destroy_open)
