"""The compliance of one history, or those of B on one contact pair, each at its own moduli."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, Numbers
from ringwear_par.contact.correction import CorrectedBatch
from ringwear_par.elasticity.pair import ContactCompliance, ContactPair


@dataclass(frozen=True)
class Compliances:
    """How the contact elements of one history yield, or those of B histories.

    Parameters
    ----------
    every : compliances at all the different moduli, that of the first history first.
    which : (B,) int, the one of each history; None: there is one history, and one compliance.
    own : (..., n) float, mm/MPa, what each element yields to its own pressure alone.
    stiffness : float or (B,), MPa/mm, uniform pressure over the mean displacement that it makes.
    twist : (..., n) float, mm/MPa, see ``ContactCompliance``.
    symmetry_defect : float or (B,), see there.
    """

    every: Sequence[ContactCompliance]
    which: IntArray | None
    own: FloatArray
    stiffness: Numbers
    twist: FloatArray
    symmetry_defect: Numbers

    @classmethod
    def of_one(cls, compliance: ContactCompliance) -> Self:
        """Return that of a single history."""
        return cls._of([compliance], None)

    @classmethod
    def of_many(
        cls,
        moduli: Sequence[tuple[float, float]],
        pair: ContactPair,
        known: Mapping[tuple[float, float], ContactCompliance],
    ) -> Self:
        """Return those of B histories; some may be known by their moduli."""
        places = {each: place for place, each in enumerate(dict.fromkeys(moduli))}
        every = [known.get(each) or pair.compliance(each) for each in places]
        return cls._of(every, np.array([places[each] for each in moduli]))

    @classmethod
    def _of(cls, every: Sequence[ContactCompliance], which: IntArray | None) -> Self:
        area = every[0].line.area

        def each(number: Callable[[ContactCompliance], Any]) -> Any:
            found = [number(compliance) for compliance in every]
            return found[0] if which is None else np.array(found)[which]

        return cls(
            every,
            which,
            each(lambda compliance: np.diagonal(compliance.matrix) / area),
            each(lambda compliance: float(area.sum() / compliance.matrix.sum())),
            each(lambda compliance: compliance.twist),
            each(lambda compliance: compliance.symmetry_defect),
        )

    def history(self, i: int) -> ContactCompliance:
        """Return that of one of B histories."""
        assert self.which is not None
        return self.every[self.which[i]]

    def take(self, histories: IntArray) -> "Compliances":
        """Return those of some of B histories."""
        assert self.which is not None
        return Compliances(
            self.every,
            self.which[histories],
            self.own[histories],
            self.stiffness[histories],
            self.twist[histories],
            self.symmetry_defect[histories],
        )

    def contacts(self) -> CorrectedBatch:
        """Return the contacts of B histories. Not collective."""
        from ringwear_par.contact.batch import BatchSolver  # compiled, and slow to import

        assert self.which is not None
        area = self.every[0].line.area
        matrices = np.array([each.matrix for each in self.every])
        excess = np.array([each.excess for each in self.every])
        stiffness = area / np.diagonal(matrices, axis1=1, axis2=2)
        solver = BatchSolver(matrices, self.which, area)
        return CorrectedBatch(solver, excess, self.which, stiffness)
