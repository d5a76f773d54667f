"""Compliances of a contact pair whose moduli are in about the same ratio, as they differ from one.

The collocated compliance is linear in those of both bodies, so that with that of a reference, of
Young's moduli (ratio, 1) MPa,

    C = share (C_ref + deviation C'),    K = share (K_ref + deviation K').

The second stands for the symmetric compliance (see ``pair.symmetric``), which is linear but for
3e-6 of it: it has to be near to the collocated one, no more, as histories take from the gap what it
has more. So no history needs a matrix of its own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.pair import ContactCompliance, ContactPair

#: references an octave of the ratio of moduli
_PER_OCTAVE = 2


def family_number(young: tuple[float, float]) -> int:
    """Return the number of the family of Young's moduli of lower and upper."""
    return round(_PER_OCTAVE * math.log2(young[0] / young[1]))


@dataclass(frozen=True)
class Members:
    """k compliances, as they differ from the references of their families."""

    #: (k,) float
    share: FloatArray
    deviation: FloatArray
    #: (k, n) float, mm/MPa, displacements of elements under their own pressures alone
    diagonal: FloatArray
    #: (k,) float, MPa/mm, uniform pressure over the mean displacement that it makes
    stiffness: FloatArray
    #: (k, n) and (k,) float, see ``ContactCompliance``
    twist: FloatArray
    symmetry_defect: FloatArray

    @classmethod
    def of_reference(cls, compliance: ContactCompliance) -> "Members":
        """Return a compliance that is a reference itself."""
        matrix, area = compliance.matrix, compliance.line.area
        return cls(
            np.ones(1), np.zeros(1), np.diagonal(matrix)[None] / area,
            np.array([float(area.sum() / matrix.sum())]), compliance.twist[None],
            np.array([compliance.symmetry_defect]),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ComplianceFamily:
    """Compliances near to that of a reference, whose moduli are (ratio, 1) MPa."""

    pair: ContactPair
    ratio: float
    reference: ContactCompliance
    #: share of the reference in the upper body's compliance
    gamma: float
    #: (n, n) float, mm^3/MPa, K'
    derivative: FloatArray
    #: (n, n) float, mm/MPa, what K' has more than C'
    excess_derivative: FloatArray

    @classmethod
    def of(cls, pair: ContactPair, number: int) -> "ComplianceFamily":
        """Return a family. Not collective.

        Raises
        ------
        ComputationError : a compliance is not positive definite.
        """
        area, ratio = pair.line.area, 2.0 ** (number / _PER_OCTAVE)
        reference = pair.compliance((ratio, 1.0))
        weighted = area[:, None] * pair.normal[1]
        # so that K' is small
        shares = eigh(0.5 * (weighted + weighted.T), reference.matrix, eigvals_only=True)
        gamma = 0.5 * float(shares[0] + shares[-1])
        ends = [(ratio * 2.0**by, 1.0) for by in (-0.5 / _PER_OCTAVE, 0.5 / _PER_OCTAVE)]
        share, deviation = np.array([_linear(ratio, gamma, young) for young in ends]).T
        low, high = (pair.compliance(end).matrix / c for end, c in zip(ends, share, strict=True))
        derivative = (high - low) / (deviation[1] - deviation[0])
        collocated = pair.normal[1] - gamma * reference.collocated
        excess = derivative / area[:, None] - collocated
        return cls(pair, ratio, reference, gamma, derivative, excess)

    def members(self, young: Sequence[tuple[float, float]]) -> Members:
        """Return k compliances, with Young's moduli of lower and upper, MPa."""
        share, deviation = np.array([_linear(self.ratio, self.gamma, pair) for pair in young]).T
        area, matrix = self.pair.line.area, self.reference.matrix
        diagonal = np.diagonal(matrix) + deviation[:, None] * np.diagonal(self.derivative)
        total = matrix.sum() + deviation * self.derivative.sum()
        twist = [self.pair.twist[0] / x + self.pair.twist[1] / y for x, y in young]
        weighted = area[:, None] * self.pair.normal
        skew = weighted - weighted.transpose(0, 2, 1)
        defect = [
            _largest(skew[0] / x + skew[1] / y) / _largest(weighted[0] / x + weighted[1] / y)
            for x, y in young
        ]
        return Members(
            share, deviation, share[:, None] * diagonal / area, area.sum() / (share * total),
            np.array(twist) / area.sum(), np.array(defect),
        )  # fmt: skip


def family_of(pair: ContactPair, number: int) -> ComplianceFamily:
    """Return a family of a pair, which keeps it. Not collective."""
    if number not in pair.families:
        pair.families[number] = ComplianceFamily.of(pair, number)
    family: ComplianceFamily = pair.families[number]
    return family


def _largest(matrix: FloatArray) -> float:
    return float(max(matrix.max(), -matrix.min()))


def _linear(ratio: float, gamma: float, young: tuple[float, float]) -> tuple[float, float]:
    """Return share and deviation of a compliance with these moduli."""
    lower, upper = young
    upper_excess = 1.0 / upper - ratio / lower
    share = ratio / lower + gamma * upper_excess
    return share, upper_excess / share
