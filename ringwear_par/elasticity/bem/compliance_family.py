"""Compliances of a contact pair whose moduli are in about the same ratio, as they differ from one.

The symmetric compliance K (see ``pair.symmetric``) is linear in the compliances of both bodies but
for a small part, which is smooth in the ratio of the moduli: with those of a reference,

    K = c (K_ref + e D + U).

D is about the symmetric part of the upper body's compliance, less the share of K_ref that makes it
smallest. U is what is not linear: 3e-6 of K at most, of low rank, interpolated between Chebyshev
nodes to 1e-13 of the diagonals of K for the paper's rings, and to 5e-12 for rings of 0.2 mm. So no
history needs a matrix of its own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from scipy.linalg import eigh

from ringwear_par.arrays import FloatArray, inner
from ringwear_par.elasticity.bem.pair import ContactCompliance, ContactPair

#: references an octave of the ratio of moduli
_PER_OCTAVE = 2
_NODES = 7
#: columns of the factors of U
_RANK = 16


def family_number(young: tuple[float, float]) -> int:
    """Return the number of the family of Young's moduli of lower and upper."""
    return round(_PER_OCTAVE * math.log2(young[0] / young[1]))


@dataclass(frozen=True)
class Members:
    """k compliances, as they differ from the references of their families."""

    #: (k,) float, c and e
    share: FloatArray
    change: FloatArray
    #: (k,) float, largest size of e D relative to K_ref
    contraction: FloatArray
    #: (k, nodes) float, polynomials of the logarithm of the ratio, of which U is made
    polynomials: FloatArray
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
            np.ones(1), np.zeros(1), np.zeros(1), np.zeros((1, _NODES)),
            np.diagonal(matrix)[None] / area, np.array([float(area.sum() / matrix.sum())]),
            compliance.twist[None], np.array([compliance.symmetry_defect]),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ComplianceFamily:
    """Compliances near to that of a reference, whose moduli are (ratio, 1) MPa."""

    pair: ContactPair
    ratio: float
    reference: ContactCompliance
    #: share of the reference in the upper body's compliance
    gamma: float
    #: largest size of D relative to K_ref
    largest_change: float
    #: (n, n) float, mm^3/MPa, D
    change: FloatArray
    #: (n, n) float, mm/MPa, what D has more than the same of collocated compliances
    excess_change: FloatArray
    #: (n, rank) and (nodes, rank, rank) float, by polynomials U is factors core factors'
    factors: FloatArray
    cores: FloatArray

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
        upper = 0.5 * (weighted + weighted.T)
        scale = np.sqrt(np.diag(reference.matrix))
        shares = eigh(upper, reference.matrix, eigvals_only=True)
        gamma = 0.5 * float(shares[0] + shares[-1])
        change = upper - gamma * reference.matrix
        excess = change / area[:, None] - (pair.normal[1] - gamma * reference.collocated)
        nodes = chebyshev.chebpts1(_NODES)
        young = [(ratio * 2.0 ** (0.5 * node / _PER_OCTAVE), 1.0) for node in nodes.tolist()]
        share, by = np.array([_linear(ratio, gamma, *moduli) for moduli in young]).T
        matrices = np.array([pair.compliance(moduli).matrix for moduli in young])
        left = matrices / share[:, None, None] - reference.matrix
        by /= share
        linear = np.tensordot(by, left, axes=1) / (by @ by)
        excess += (linear - change) / area[:, None]
        scaled = (left - by[:, None, None] * linear) / (scale[:, None] * scale)
        vectors = np.zeros((len(area), _RANK))  # as many for all: products depend on it
        singular = np.linalg.svd(np.concatenate(list(scaled), axis=1), full_matrices=False)
        singular = singular[0][:, :_RANK]
        vectors[:, : singular.shape[1]] = singular
        cores = vectors.T @ scaled @ vectors
        vandermonde = chebyshev.chebvander(nodes, _NODES - 1)
        by_polynomials = np.linalg.solve(vandermonde, cores.reshape(_NODES, -1))
        return cls(
            pair, ratio, reference, gamma, float(shares[-1]) - gamma, linear, excess,
            scale[:, None] * vectors, by_polynomials.reshape(cores.shape),
        )  # fmt: skip

    def members(self, young: Sequence[tuple[float, float]]) -> Members:
        """Return k compliances, with Young's moduli of lower and upper, MPa."""
        share, by = np.array([_linear(self.ratio, self.gamma, *moduli) for moduli in young]).T
        places = [2.0 * _PER_OCTAVE * math.log2(x / y / self.ratio) for x, y in young]
        polynomials = chebyshev.chebvander(np.array(places), _NODES - 1)
        area, factors, change = self.pair.line.area, self.factors, by / share
        matrix, whole = self.reference.matrix, factors.sum(axis=0)
        small = (factors @ self.cores * factors).sum(axis=-1)
        diagonal = np.diagonal(matrix) + change[:, None] * np.diagonal(self.change)
        diagonal += inner(polynomials[:, None], small.T)
        sums = inner(whole, inner(whole, self.cores))
        total = matrix.sum() + change * self.change.sum() + inner(sums, polynomials)
        twist = [self.pair.twist[0] / x + self.pair.twist[1] / y for x, y in young]
        weighted = area[:, None] * self.pair.normal
        skew = weighted - weighted.transpose(0, 2, 1)
        defect = [
            _largest(skew[0] / x + skew[1] / y) / _largest(weighted[0] / x + weighted[1] / y)
            for x, y in young
        ]
        return Members(
            share, change, self.largest_change * np.abs(change), polynomials,
            share[:, None] * diagonal / area, area.sum() / (share * total),
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


def _linear(ratio: float, gamma: float, lower: float, upper: float) -> tuple[float, float]:
    """Return c, and e c, of a compliance with these moduli."""
    by = 1.0 / upper - ratio / lower
    return ratio / lower + gamma * by, by
