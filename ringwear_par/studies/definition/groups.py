"""Numbers of cases by group, in two arrays whatever their number."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import BoolArray, IntArray


@dataclass(frozen=True, eq=False)
class Groups:
    """Groups of cases; those of group g are ``groups[g]``.

    Parameters
    ----------
    cases : numbers of the cases, group after group.
    starts : (groups + 1,) where each begins.
    """

    cases: IntArray
    starts: IntArray

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, group: int) -> IntArray:
        return self.cases[self.starts[group] : self.starts[group + 1]]

    def __iter__(self) -> Iterator[IntArray]:
        return (self[group] for group in range(len(self)))

    @property
    def sizes(self) -> IntArray:
        """Number of the cases of each group."""
        return np.diff(self.starts)

    def only(self, wanted: BoolArray) -> "Groups":
        """Return the same groups of those cases only that are wanted.

        Parameters
        ----------
        wanted : by number of the case.
        """
        kept = wanted[self.cases]
        starts = np.concatenate([[0], np.cumsum(kept)])[self.starts]
        return Groups(self.cases[kept], starts)
