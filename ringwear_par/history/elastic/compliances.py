"""The compliances of B histories on one contact line, each of its own pair and moduli."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.batched import along, take
from ringwear_par.cases.case import Case
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.contact.engine import ContactEngine
from ringwear_par.contact.scaled_compliances import ScaledCompliances
from ringwear_par.elasticity.bem.pair import ContactCompliance, ContactPair
from ringwear_par.history.elastic.bodies import young

#: identity of a contact pair, and Young's moduli of lower and upper
OperatorKey = tuple[int, tuple[float, float]]


def key_of(pair: ContactPair, case: Case) -> OperatorKey:
    """Return the key of the compliance of a case among those of some pairs."""
    return id(pair), young(case)


@dataclass(frozen=True)
class Compliances:
    """How the contact elements of B histories yield."""

    #: compliances of all different pairs and moduli, that of the first history first
    every: Sequence[ContactCompliance] = field(metadata=along(None))
    #: (B,) int, the one of each history
    which: IntArray
    #: (m, n) float, mm/MPa, displacements of elements under their own pressures alone, of the
    #: different compliances
    diagonals: FloatArray = field(metadata=along(None))
    #: (B,) float, MPa/mm, uniform pressure over the mean displacement that it makes
    stiffness: FloatArray
    #: (B,) float, see ``ContactCompliance``
    symmetry_defect: FloatArray

    @classmethod
    def of(
        cls,
        pairs: Sequence[ContactPair],
        cases: Sequence[Case],
        known: Mapping[OperatorKey, ContactCompliance],
    ) -> Self:
        """Return the compliances of histories; some may be known."""
        keys = [key_of(*row) for row in zip(pairs, cases, strict=True)]
        pair_of = dict(zip(keys, pairs, strict=True))
        places = {key: place for place, key in enumerate(pair_of)}
        every = [known.get(key) or pair.compliance(key[1]) for key, pair in pair_of.items()]
        return cls._of(every, np.array([places[key] for key in keys]))

    @classmethod
    def of_each(cls, compliances: Sequence[ContactCompliance]) -> Self:
        """Return the compliances of histories that have one each."""
        return cls._of(compliances, np.arange(len(compliances)))

    @classmethod
    def _of(cls, every: Sequence[ContactCompliance], which: IntArray) -> Self:
        area = every[0].line.area
        return cls(
            every,
            which,
            np.array([np.diagonal(c.matrix) / area for c in every]),
            np.array([float(area.sum() / c.matrix.sum()) for c in every])[which],
            np.array([c.symmetry_defect for c in every])[which],
        )

    @property
    def diagonal(self) -> FloatArray:
        """(B, n) mm/MPa, displacement of each element under its own pressure alone."""
        return self.diagonals[self.which]

    @property
    def twist(self) -> FloatArray:
        """(B, n) mm/MPa, see ``ContactCompliance``."""
        return np.array([c.twist for c in self.every])[self.which]

    @property
    def force_reaction(self) -> FloatArray:
        """(B, 2, n) mm^2, see ``ContactCompliance``."""
        return np.array([c.force_reaction for c in self.every])[self.which]

    @property
    def torque_reaction(self) -> FloatArray:
        """(B, 2, n) mm^3, see ``ContactCompliance``."""
        return np.array([c.torque_reaction for c in self.every])[self.which]

    def history(self, i: int) -> ContactCompliance:
        """Return the compliance of one history."""
        return self.every[self.which[i]]

    def take(self, histories: IntArray) -> "Compliances":
        """Return the compliances of some of the histories."""
        return take(self, histories)

    def scaled(self) -> ScaledCompliances:
        """Return the different compliances as contact problems have them."""
        line = self.every[0].line
        return ScaledCompliances.of(
            np.array([c.matrix for c in self.every]),
            line.area,
            speed=np.array([line.arm * c.obliquity for c in self.every]),
            excess=np.array([c.excess for c in self.every]),
        )

    def contacts(self) -> CorrectedContacts:
        """Return the contacts of the histories. Not collective."""
        return CorrectedContacts(ContactEngine(self.scaled(), self.which))
