"""Derivatives of the compliance of a pair by Young's moduli and by the numbers of layers.

By moduli of bodies without layers, those of the collocated compliance are exact. By numbers of
layers they are differences of compliances (``elasticity.bem.pair``); another value of such a number
needs another pair.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import layer_entry
from ringwear_par.compiled.product_rows import Matrices
from ringwear_par.contact.row_products import RowProducts
from ringwear_par.elasticity.bem.compliance_family import family_number, family_of
from ringwear_par.elasticity.bem.pair import ComplianceChange, ContactPair, Entry, layer_derivative
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.history.elastic.bodies import bodies, may_share_reference, young
from ringwear_par.history.elastic.compliances import key_of

_ENTRIES: tuple[Entry, ...] = ("thickness", "young", "poisson")


@dataclass(frozen=True)
class ElasticDerivatives:
    """Derivatives with respect to a number of m compliances, of other pairs or moduli."""

    #: (m, n, n) of K / m and C, transposed
    symmetric: FloatArray
    collocated: FloatArray
    #: (m, n)
    twist: FloatArray
    #: (B,) int of each history, or 0
    which: Any

    @classmethod
    def of(
        cls, cases: Sequence[Case], pairs: Sequence[ContactPair], key: str
    ) -> "ElasticDerivatives":
        """Return the derivatives of some cases, each on its pair."""
        operators = [key_of(pair, case) for pair, case in zip(pairs, cases, strict=True)]
        firsts = dict(zip(operators, zip(pairs, cases, strict=True), strict=True))
        places = {operator: place for place, operator in enumerate(firsts)}
        every = [_derivatives(case, pair, key) for pair, case in firsts.values()]
        area = pairs[0].line.area
        return cls(
            np.array([(matrix / area[:, None]).T for matrix, _, _ in every]),
            np.array([collocated.T for _, collocated, _ in every]),
            np.array([twist for _, _, twist in every]),
            np.array([places[operator] for operator in operators]),
        )

    def take(self, histories: IntArray) -> "ElasticDerivatives":
        """Return the derivatives of some of B histories."""
        return replace(self, which=self.which[histories])

    def add_gap(self, gap: FloatArray, p: FloatArray, at: FloatArray) -> None:
        """Add to derivatives of the gap, (..., n) mm; pressures as those of ``Sensitivity``."""
        products = RowProducts(self.which)
        gap += products.of(p - at, Matrices.of(self.symmetric))
        gap += products.of(at, Matrices.of(self.collocated))


def _derivatives(
    case: Case, pair: ContactPair, key: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives of ``ContactPair.d_compliance`` by a key."""
    change, moduli = compliance_change(case, pair, key), young(case)
    if layer_entry(key) is not None or not may_share_reference(case):
        return pair.d_compliance(moduli, change)
    family, body = family_of(pair, family_number(moduli)), BODIES.index(key.partition(".")[0])
    matrix = family.derivative_by_modulus(moduli, body)
    return matrix, change.normal, change.twist / pair.line.area.sum()


def compliance_change(case: Case, pair: ContactPair, key: str) -> ComplianceChange:
    """Return derivatives of the collocated compliance and of the twist. Not collective.

    Parameters
    ----------
    pair : of the case.
    key : one of ``elastic_numbers``, or Young's modulus of any body.

    Returns
    -------
    (n, n) and (n,), mm/MPa and mm^3/MPa over the unit of the number; moduli are included.
    """
    which = BODIES.index("lower" if key.startswith("lower.") else "upper")
    ring = case.rings[which]
    share = 1.0 / ring.young
    entry = layer_entry(key)
    if entry is not None:
        change = _of_layer(case, pair, which, int(entry[1][1:-1]), entry[2])
        factor = share * share if entry[2] == "young" else share
        return ComplianceChange(factor * change.normal, factor * change.twist)
    normal = -share * share * pair.normal[which]
    twist = -share * share * pair.twist[which]
    for i, layer in enumerate(ring.layers):  # a stiffer body has layers softer than it
        change = _of_layer(case, pair, which, i, "young")
        normal -= layer.young * share**3 * change.normal
        twist -= layer.young * share**3 * change.twist
    return ComplianceChange(normal, twist)


def _of_layer(
    case: Case, pair: ContactPair, which: int, layer: int, entry: str
) -> ComplianceChange:
    """Return derivatives of a body of modulus 1 to a number of a layer; the pair keeps them."""
    known = pair.changes
    name = which, layer, entry
    if name not in known:
        (number,) = (known for known in _ENTRIES if known == entry)
        slope = (pair.slope, -pair.slope)[which]
        body = bodies(case)[which]
        known[name] = layer_derivative(
            body, layer, number, pair.line, case.mesh, slope, MPI.COMM_SELF
        )
    return known[name]
