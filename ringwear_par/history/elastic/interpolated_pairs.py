"""Contact pairs whose compliances are interpolated in the numbers of layers.

Each thickness, modulus and Poisson's ratio of a layer has an operator of its own, of which a search
tries hundreds. Compliances are smooth in the logarithms of thickness and modulus, so that
polynomials through few Chebyshev nodes give them with their derivatives: within a decade of either,
6 nodes are off by 3e-4 of the largest entry, 8 by 4e-5. The error is measured where it is largest,
half way between nodes.
"""

import itertools
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from numpy.polynomial import chebyshev

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.bem.body import compliance
from ringwear_par.elasticity.bem.pair import ComplianceChange, ContactPair, Entry
from ringwear_par.elasticity.mesh import ContactLine, Mesh
from ringwear_par.elasticity.sections import BODIES, Body
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.history.elastic.bodies import bodies, operator_key

log = logging.getLogger(__name__)

#: of the largest entry of a compliance, by which it may be off in a search
TOLERANCE = 1e-3
#: nodes of a number: fewest, by decade of its range, most
_FEWEST, _A_DECADE, _MOST = 4, 6.0, 10


@dataclass(frozen=True)
class _Axis:
    """A number of a layer from its lowest to its highest value; of moduli over that of the body."""

    layer: int
    entry: Entry
    low: float
    high: float
    count: int

    @classmethod
    def of(cls, layer: int, entry: Entry, low: float, high: float) -> "_Axis":
        """Return the axis with as many nodes as its range needs, as far as is known before."""
        decades = 0.0 if entry == "poisson" else math.log10(high / low)
        count = 2 * math.ceil(0.5 * max(_FEWEST, _A_DECADE * decades))
        return cls(layer, entry, low, high, count)

    def finer(self) -> "_Axis":
        """Return the axis with two more nodes."""
        return replace(self, count=self.count + 2)

    @property
    def _ends(self) -> tuple[float, float]:
        linear = self.entry == "poisson"
        return (self.low, self.high) if linear else (math.log(self.low), math.log(self.high))

    def value(self, coordinate: float) -> float:
        """Return the number at a coordinate from -1 to 1."""
        low, high = self._ends
        along = low + 0.5 * (coordinate + 1.0) * (high - low)
        return along if self.entry == "poisson" else math.exp(along)

    @property
    def nodes(self) -> list[float]:
        """Values at the Chebyshev nodes."""
        return [self.value(x) for x in chebyshev.chebpts1(self.count).tolist()]

    def weights(self, value: float) -> tuple[FloatArray, FloatArray]:
        """Return the weights of the nodes at a value, (count,), and their derivatives by it."""
        low, high = self._ends
        linear = self.entry == "poisson"
        x = 2.0 * ((value if linear else math.log(value)) - low) / (high - low) - 1.0
        slope = 2.0 / (high - low) / (1.0 if linear else value)
        polynomials = np.linalg.inv(
            chebyshev.chebvander(chebyshev.chebpts1(self.count), self.count - 1)
        )
        return (
            chebyshev.chebval(x, polynomials),
            slope * chebyshev.chebval(x, chebyshev.chebder(polynomials)),
        )


@dataclass(frozen=True)
class _Numbers:
    """The numbers of a body's layers that vary."""

    body: Body
    axes: tuple[_Axis, ...]

    @classmethod
    def of(cls, case: Case, which: int, bounds: Mapping[str, tuple[float, float]]) -> "_Numbers":
        """Return the numbers of a body of a case that vary within bounds, by their keys."""
        body, name, axes = bodies(case)[which], BODIES[which], []
        low, high = bounds.get(f"{name}.young", (body.young, body.young))
        layers = zip(body.section.layers, body.layers, strict=True)
        for i, (thickness, material) in enumerate(layers):
            key = f"{name}.layers[{i}]"
            soft, hard = bounds.get(f"{key}.young", (material.young, material.young))
            ranges: dict[Entry, tuple[float, float]] = {
                "thickness": bounds.get(f"{key}.thickness", (thickness, thickness)),
                "young": (soft / high, hard / low),
                "poisson": bounds.get(f"{key}.poisson", (material.poisson, material.poisson)),
            }
            axes += [_Axis.of(i, k, *ends) for k, ends in ranges.items() if ends[0] < ends[1]]
        return cls(body, tuple(axes))

    @property
    def count(self) -> int:
        """How many nodes there are, 0 where nothing varies."""
        return math.prod(axis.count for axis in self.axes) if self.axes else 0

    def at(self, values: Sequence[float]) -> Body:
        """Return the body with other numbers."""
        thicknesses, materials = list(self.body.section.layers), list(self.body.layers)
        for axis, value in zip(self.axes, values, strict=True):
            if axis.entry == "thickness":
                thicknesses[axis.layer] = value
            else:
                number = value * self.body.young if axis.entry == "young" else value
                materials[axis.layer] = replace(materials[axis.layer], **{axis.entry: number})
        section = replace(self.body.section, layers=tuple(thicknesses))
        return replace(self.body, section=section, layers=tuple(materials))

    def of_body(self, body: Body) -> list[float]:
        """Return the numbers of a body."""
        return [
            body.section.layers[axis.layer]
            if axis.entry == "thickness"
            else getattr(body.layers[axis.layer], axis.entry)
            / (body.young if axis.entry == "young" else 1.0)
            for axis in self.axes
        ]


class InterpolatedPairs:
    """Contact pairs of cases that differ in numbers of layers. Not collective.

    Parameters
    ----------
    pair : exact, of one of the cases.
    numbers : of lower and upper, that vary.
    nodes : of lower and upper, (count, n + 3, n): ``normal``, ``twist``, ``force_reaction`` and
        ``torque_reaction`` of ``ContactPair`` at the nodes.
    error : largest, of the largest entry of a compliance.
    """

    def __init__(
        self,
        pair: ContactPair,
        numbers: Sequence[_Numbers],
        nodes: Sequence[FloatArray],
        error: float,
    ) -> None:
        self._pair, self._numbers, self._nodes, self.error = pair, numbers, nodes, error

    def of(self, case: Case) -> ContactPair:
        """Return the pair of a case, with the derivatives by the numbers that vary."""
        pair, n = self._pair, self._pair.line.n
        rest = pair.twist, pair.force_reaction, pair.torque_reaction
        stacked = np.concatenate([pair.normal, np.stack(rest, axis=1)], axis=1)
        changes: dict[tuple[int, int, str], ComplianceChange] = {}
        for i, (numbers, nodes) in enumerate(zip(self._numbers, self._nodes, strict=True)):
            if not numbers.count:
                continue
            values = numbers.of_body(bodies(case)[i])
            stacked[i] = _interpolated(numbers.axes, nodes, values)
            for k, axis in enumerate(numbers.axes):
                change = _interpolated(numbers.axes, nodes, values, derivative=k)
                changes[i, axis.layer, axis.entry] = ComplianceChange(change[:n], change[n])
        parts = stacked[:, :n], stacked[:, n], stacked[:, n + 1], stacked[:, n + 2]
        interpolated = ContactPair(pair.line, *parts, pair.slope, operator_key(case))
        interpolated.changes.update(changes)
        return interpolated


def _interpolated(
    axes: Sequence[_Axis],
    nodes: FloatArray,
    values: Sequence[float],
    derivative: int | None = None,
) -> FloatArray:
    """Return (n + 3, n) between nodes, or its derivative by the value of an axis."""
    weights = np.ones(1)
    for k, (axis, value) in enumerate(zip(axes, values, strict=True)):
        weights = np.multiply.outer(weights, axis.weights(value)[k == derivative]).ravel()
    interpolated: FloatArray = np.tensordot(weights, nodes, axes=1)
    return interpolated


def interpolate(
    case: Case,
    pair: ContactPair,
    bounds: Mapping[str, tuple[float, float]],
    most: int,
    comm: MPI.Comm,
) -> InterpolatedPairs | None:
    """Return pairs of all cases within bounds of numbers; None where exact ones are better.

    That is where more than ``most`` bodies would have to be assembled, one of them cannot be, or
    the pairs would be off by more than ``TOLERANCE``. Collective on comm, each of whose ranks
    assembles some.

    Parameters
    ----------
    case : one of the cases.
    pair : of the case.
    bounds : lowest and highest value of each number that varies, by its key.
    """
    both = [_Numbers.of(case, which, bounds) for which in range(2)]
    spent = 0
    while all(axis.count <= _MOST for numbers in both for axis in numbers.axes):
        spent += sum(numbers.count + bool(numbers.count) for numbers in both)
        if not 0 < spent <= most:
            return None
        nodes, errors = [], [0.0]
        for numbers, slope in zip(both, (pair.slope, -pair.slope), strict=True):
            if not numbers.count:
                nodes.append(np.zeros(0))
                continue
            points = list(itertools.product(*(axis.nodes for axis in numbers.axes)))
            middle = [axis.value(0.0) for axis in numbers.axes]
            stacks = _assembled(numbers, [*points, middle], pair.line, case.mesh, slope, comm)
            if stacks is None:
                return None
            between = _interpolated(numbers.axes, stacks[:-1], middle)
            errors.append(float(np.abs(between - stacks[-1])[: pair.line.n].max()
                                / np.abs(stacks[-1][: pair.line.n]).max()))  # fmt: skip
            nodes.append(stacks[:-1])
        if max(errors) <= TOLERANCE:
            return InterpolatedPairs(pair, both, nodes, max(errors))
        both = [
            replace(numbers, axes=tuple(axis.finer() for axis in numbers.axes)) for numbers in both
        ]
    return None


def _assembled(
    numbers: _Numbers,
    points: Sequence[Sequence[float]],
    line: ContactLine,
    mesh: Mesh,
    slope: FloatArray,
    comm: MPI.Comm,
) -> FloatArray | None:
    """Return exact nodes (points, n + 3, n) at some points; None where one cannot be assembled.

    Collective.
    """
    stacks: list[FloatArray] = []
    whole = True
    for values in points[comm.rank :: comm.size]:
        try:
            body = compliance(numbers.at(values), line, mesh, MPI.COMM_SELF, slope=slope)
        except (ComputationError, InputError) as error:
            log.debug("no operator at a node: %s", error)
            whole = False
            break
        rest = line.area @ body.torsion, body.force_reaction, body.torque_reaction
        stacks.append(np.concatenate([body.normal, rest]))
    shares = comm.allgather(stacks)
    if not comm.allreduce(whole, MPI.LAND):
        return None
    every = np.empty((len(points), line.n + 3, line.n))
    for rank, share in enumerate(shares):
        every[rank :: comm.size] = np.reshape(share, (-1, *every.shape[1:]))
    return every
