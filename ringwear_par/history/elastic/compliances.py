"""The compliances of B histories on one contact line, each of its own pair and moduli."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.batched import along, concat, take
from ringwear_par.cases.case import Case
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.contact.engine import ContactEngine
from ringwear_par.contact.scaled_compliances import Deviations, ScaledCompliances
from ringwear_par.elasticity.bem.compliance_family import (
    ComplianceFamily,
    Members,
    family_number,
    family_of,
)
from ringwear_par.elasticity.bem.pair import ContactCompliance, ContactPair
from ringwear_par.history.elastic.bodies import shares_reference, young

#: identity of a contact pair, and Young's moduli of lower and upper
OperatorKey = tuple[int, tuple[float, float]]


def key_of(pair: ContactPair, case: Case) -> OperatorKey:
    """Return the key of the compliance of a case among those of some pairs."""
    return id(pair), young(case)


@dataclass(frozen=True)
class Compliances:
    """The different compliances of B histories, and which history has which."""

    #: f references: compliances of pairs and moduli, and those of families
    every: Sequence[ContactCompliance] = field(metadata=along(None))
    #: families, whose references are the last ones
    families: Sequence[ComplianceFamily] = field(metadata=along(None))
    #: m different compliances, and (m,) int their references
    members: Members = field(metadata=along(None))
    reference: IntArray = field(metadata=along(None))
    #: (B,) int, the compliance of each history
    which: IntArray

    @classmethod
    def of(cls, pairs: Sequence[ContactPair], cases: Sequence[Case]) -> Self:
        """Return the compliances of histories."""
        keys = [key_of(*row) for row in zip(pairs, cases, strict=True)]
        firsts = dict(zip(keys, zip(pairs, cases, strict=True), strict=True))
        families: dict[tuple[int, int], list[OperatorKey]] = defaultdict(list)
        single: dict[OperatorKey, ContactCompliance] = {}
        for key, (pair, case) in firsts.items():
            if shares_reference(case):
                families[key[0], family_number(key[1])].append(key)
            else:
                single[key] = pair.compliance(key[1])
        order = [*single, *(key for row in families.values() for key in row)]
        places = {key: place for place, key in enumerate(order)}
        members = {
            family_of(firsts[row[0]][0], number): [key[1] for key in row]
            for (_, number), row in families.items()
        }
        return cls._of(single, members, np.array([places[key] for key in keys]))

    @classmethod
    def of_each(cls, compliances: Sequence[ContactCompliance]) -> Self:
        """Return the compliances of histories that have one each."""
        single = {(i, (0.0, 0.0)): compliance for i, compliance in enumerate(compliances)}
        return cls._of(single, {}, np.arange(len(compliances)))

    @classmethod
    def _of(
        cls,
        single: Mapping[OperatorKey, ContactCompliance],
        families: Mapping[ComplianceFamily, Sequence[tuple[float, float]]],
        which: IntArray,
    ) -> Self:
        """Return compliances, of families those of some moduli, in this order."""
        parts = [Members.of_reference(compliance) for compliance in single.values()]
        parts += [family.members(young) for family, young in families.items()]
        reference = np.repeat(np.arange(len(parts)), [len(part.share) for part in parts])
        every = [*single.values(), *(family.reference for family in families)]
        return cls(every, tuple(families), concat(parts), reference, which)

    @property
    def diagonal(self) -> FloatArray:
        """(B, n) mm/MPa, displacement of each element under its own pressure alone."""
        return _rows(self.members.diagonal, self.which)

    @property
    def stiffness(self) -> FloatArray:
        """(B,) MPa/mm, uniform pressure over the mean displacement that it makes."""
        return self.members.stiffness[self.which]

    @property
    def symmetry_defect(self) -> FloatArray:
        """(B,), see ``ContactCompliance``."""
        return self.members.symmetry_defect[self.which]

    @property
    def twist(self) -> FloatArray:
        """(B, n) mm/MPa, see ``ContactCompliance``."""
        return _rows(self.members.twist, self.which)

    @property
    def reactions(self) -> FloatArray:
        """(B, 4, n) mm^2 and mm^3, ``force_reaction`` and ``torque_reaction``.

        See ``ContactCompliance``; boundary elements turn with tractions that are constant on each.
        """
        line = self.every[0].line
        turning = line.arm / line.uniform_arm
        of_references = [[*c.force_reaction, *(c.torque_reaction * turning)] for c in self.every]
        return _rows(np.array(of_references), self.reference[self.which])

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
            reference=self.reference,
            deviations=self._deviations() if self.families else None,
        )

    def _deviations(self) -> Deviations:
        """Return how the compliances deviate from their references."""
        singles = len(self.every) - len(self.families)
        matrices, excess = np.zeros((2, len(self.every), *self.families[0].derivative.shape))
        for i, family in enumerate(self.families, start=singles):
            matrices[i], excess[i] = family.derivative, family.excess_derivative.T
        return Deviations(self.members.share, self.members.deviation, matrices, excess)

    def contacts(self) -> CorrectedContacts:
        """Return the contacts of the histories. Not collective."""
        return CorrectedContacts(ContactEngine(self.scaled(), self.which))


def _rows(values: FloatArray, which: IntArray) -> FloatArray:
    """Return some of the rows of values, (B, ...), which take no memory where there is one."""
    one_row = len(values) == 1
    return np.broadcast_to(values, (len(which), *values.shape[1:])) if one_row else values[which]
