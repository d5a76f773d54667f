"""The bases of many histories in arrays, for products of all of them at once."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringwear_par.arrays import BoolArray, IntArray
from ringwear_par.compiled.hessian_rows import Bases
from ringwear_par.contact.scaled_compliances import ScaledCompliances

_LEAST_ROOM = 4


class BasisStack:
    """Numbered bases, each of a reference and of sets of elements in contact and wearing.

    Parameters
    ----------
    compliances : whose bases they are.
    """

    def __init__(self, compliances: ScaledCompliances) -> None:
        n = len(compliances.area)
        self._compliances = compliances
        self._numbers: dict[tuple[int, bytes], int] = {}
        #: numbers that no basis has
        self._vacant: list[int] = []
        size = 0 if compliances.deviations is None else n
        #: room for more included; K' are (m, 0, 0) where nothing deviates
        self.bases = Bases(
            psi=np.empty((0, n, n)),
            psi_t=np.empty((0, n, n)),
            mu=np.empty((0, n)),
            forces=np.empty((0, n)),
            extents=np.empty((0, 3), dtype=np.int64),
            derivatives=np.empty((0, size, size)),
            bends=np.empty((0, n)),
        )

    @property
    def is_full(self) -> bool:
        """Whether there has to be room before there can be another basis."""
        return not self._vacant

    def numbers_of(self, names: Sequence[tuple[int, bytes]]) -> IntArray:
        """Return the numbers of bases by reference and name of sets; -1 of those not here."""
        return np.array([self._numbers.get(name, -1) for name in names], dtype=np.int64)

    def number_of(self, name: tuple[int, bytes], free: BoolArray, wearing: BoolArray) -> int:
        """Return the number of a basis, which is new where there is none yet.

        Parameters
        ----------
        name : the number of the reference, and the name of the sets.
        free, wearing : (n,) bool, the sets: elements in contact, and those that wear.
        """
        compliance = name[0]
        if name not in self._numbers:
            number = self._numbers[name] = self._vacant.pop()
            basis = self._compliances.basis(compliance, free, wearing)
            bases = self.bases
            bases.psi[number], bases.mu[number], bases.forces[number] = basis
            bases.psi_t[number], bases.bends[number] = basis.psi.T, 0.0
            touching = np.flatnonzero(free)
            ends = (touching[0], touching[-1] + 1) if len(touching) else (0, 0)
            bases.extents[number] = len(touching), *ends
            more = self._compliances.deviations
            if more is not None:
                derivative = basis.psi.T @ more.derivatives[compliance] @ basis.psi
                bases.bends[number] = np.diagonal(derivative)
                np.fill_diagonal(derivative, 0.0)
                bases.derivatives[number] = derivative
        return self._numbers[name]

    def make_room(self, used: IntArray) -> None:
        """Forget the bases that are not used, so that there is room for others.

        Parameters
        ----------
        used : numbers that are; negative ones are no numbers of bases.
        """
        vacant = np.ones(len(self.bases.mu), dtype=bool)
        vacant[used[used >= 0]] = False
        self._numbers = {
            name: number for name, number in self._numbers.items() if not vacant[number]
        }
        more = len(vacant) - 2 * int(vacant.sum())  # bases that are used, less those that are not
        if more > 0 or not len(vacant):
            # room that is not used costs nothing, to copy bases does: two of each compliance
            more = max(_LEAST_ROOM, more, 2 * len(self._compliances.matrices) - len(vacant))
            self.bases = Bases(*(_longer(values, more) for values in self.bases))
            vacant = np.append(vacant, np.ones(more, dtype=bool))
        # the lowest are taken first: products are fewer where numbers follow each other
        self._vacant = np.flatnonzero(vacant)[::-1].tolist()


def _longer(values: NDArray[Any], more: int) -> NDArray[Any]:
    """Return values with room for more, whose memory is not touched."""
    longer = np.empty((len(values) + more, *values.shape[1:]), values.dtype)
    longer[: len(values)] = values
    return longer
