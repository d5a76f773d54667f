"""The bases of many histories in arrays, for products of all of them at once."""

from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, IntArray
from ringwear_par.contact.scaled_compliances import ScaledCompliances

#: instead of the number of a basis: what it would be of is not positive definite
BROKEN = -2
_LEAST_ROOM = 4


class BasisStack:
    """Numbered bases, each of a compliance and of sets of elements in contact and wearing.

    Parameters
    ----------
    compliances : whose bases they are.
    """

    def __init__(self, compliances: ScaledCompliances) -> None:
        n = len(compliances.area)
        self._compliances = compliances
        self._numbers: dict[tuple[int, bytes], int] = {}
        self._count = 0
        #: (m, n, n) and (m, n) each, room for more included; see ``Basis``
        self.psi, self.mu, self.force = np.empty((0, n, n)), np.empty((0, n)), np.empty((0, n))
        #: (m, n, n) float32, for estimates, with its transpose
        self.rough, self.rough_t = (np.empty((0, n, n), dtype=np.float32) for _ in "pt")

    def matrices(self, precision: Any) -> tuple[Any, Any]:
        """Return bases and their transposes, (m, n, n), in double or in single precision."""
        if precision == np.float32:
            return self.rough, self.rough_t
        return self.psi, self.psi.transpose(0, 2, 1)

    @property
    def is_full(self) -> bool:
        """Whether there has to be room before there can be another basis."""
        return self._count == len(self.mu)

    def number_of(self, compliance: int, sets: bytes, free: BoolArray, wearing: BoolArray) -> int:
        """Return the number of a basis, which is new where there is none yet.

        Parameters
        ----------
        compliance : its number.
        sets : the name of those that follow.
        free, wearing : (n,) bool, elements in contact, and those that wear.
        """
        name = compliance, sets
        if name not in self._numbers:
            basis = self._compliances.basis(compliance, free, wearing)
            if basis is None:
                self._numbers[name] = BROKEN
            else:
                number = self._numbers[name] = self._count
                self._count += 1
                self.psi[number], self.mu[number], self.force[number] = basis
                self.rough[number], self.rough_t[number] = basis.psi, basis.psi.T
        return self._numbers[name]

    def make_room(self, used: IntArray) -> IntArray:
        """Forget the bases that are not used, make room for as many again; return new numbers.

        Parameters
        ----------
        used : numbers that are; negative ones, which are no numbers of bases, stay.
        """
        still_used = np.unique(used[used >= 0])
        room = max(_LEAST_ROOM, len(still_used))
        self.psi, self.mu, self.force, self.rough, self.rough_t = (
            np.concatenate(
                [values[still_used], np.empty_like(values, shape=(room, *values.shape[1:]))]
            )
            for values in (self.psi, self.mu, self.force, self.rough, self.rough_t)
        )
        new = {int(number): place for place, number in enumerate(still_used)}
        self._numbers = {
            name: new.get(number, number)
            for name, number in self._numbers.items()
            if number in new or number < 0
        }
        self._count = len(still_used)
        return np.where(used >= 0, np.searchsorted(still_used, used), used)
