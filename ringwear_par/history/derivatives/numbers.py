"""What numbers of a case histories have derivatives with respect to, and what these act on."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, columns
from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import UNITS, layer_entry
from ringwear_par.contact.row_products import RowProducts
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.geometry.mesh import obliquity
from ringwear_par.elasticity.geometry.sections import BODIES
from ringwear_par.errors import InputError, legible
from ringwear_par.history.derivatives.elastic_numbers import compliance_change, elastic_numbers
from ringwear_par.history.elastic.bodies import young
from ringwear_par.history.elastic.compliances import key_of
from ringwear_par.wear.law import Law, parameters_of
from ringwear_par.wear.laws.non_local import d_averaging
from ringwear_par.wear.layered import LayeredLaw
from ringwear_par.wear.local_state import LocalState

#: names of a factor on all rates of a body, about 1, in the place of a case's key
RATES = tuple(f"wear.{body}" for body in BODIES)


def differentiable(case: Case) -> dict[str, str]:
    """Return the keys of a case that histories have derivatives with respect to, and their units.

    Its plain numbers: of a law's parameters, those that rates have derivatives with respect to.
    """
    units: dict[str, str] = {}
    for body, law in zip(BODIES, case.laws, strict=True):
        if law is None:
            continue
        for name in law.numeric:
            if _is_number(law.quantity(name)):
                units[_key_of_number(body, name)] = _unit(law, name)
        if law.length and "length" in parameters_of(type(law)):
            units[f"wear.{body}.length"] = "mm"
    units["contact.friction"] = UNITS["contact.friction"]
    load = case.load
    for key, number in (
        ("load.pressure", load.force),
        ("load.force", load.force),
        ("load.displacement", load.displacement),
        ("load.omega", load.omega),
        ("lower.young", case.lower.young),
        ("upper.young", case.upper.young),
    ):
        if _is_number(number):
            units[key] = UNITS[key]
    return units | elastic_numbers(case)


def _key_of_number(body: str, name: str) -> str:
    """Return the key of a parameter of a body's law, or of one of its layers' laws."""
    layer, _, parameter = name.rpartition("].")
    return f"{body}.{layer}].wear.{parameter}" if layer else f"wear.{body}.{name}"


def _unit(law: Law, name: str) -> str:
    """Return the unit of a parameter, "1" where it is not declared."""
    if isinstance(law, LayeredLaw):
        return next(_unit(law.laws[i], parameter) for i, parameter in law.having(name))
    parameter = parameters_of(type(law)).get(name)
    return "1" if parameter is None else parameter.unit


def _is_number(quantity: Any) -> bool:
    return isinstance(quantity, float | int) and not isinstance(quantity, bool)


def units_of(case: Case, keys: Sequence[str]) -> dict[str, str]:
    """Return the units of some of these keys."""
    units = differentiable(case) | dict.fromkeys(RATES, "1") if keys else {}
    return {key: units[key] for key in keys}


def check_derivatives(case: Case, keys: Sequence[str]) -> None:
    """Refuse derivatives that there are not. Not collective.

    Raises
    ------
    InputError : one sentence a key, or why this case has none at all.
    """
    if isinstance(keys, str) or not all(isinstance(key, str) for key in keys):
        raise InputError(f"derivatives = {keys!r}: must be a list of keys, as ['wear.lower.k']")
    if not keys:
        return
    if case.follows_wear:
        raise InputError(
            'derivatives: are not known with mesh.geometry = "updated"; must be "fixed" with them'
        )
    allowed = differentiable(case)
    faults = [
        f"derivatives: {legible(key)}: is no plain number of this case that its history depends "
        f"on smoothly; must be one of {', '.join(allowed)}"
        for key in keys
        if key not in allowed
    ]
    twice = dict.fromkeys(key for key in keys if list(keys).count(key) > 1)
    faults += [f"derivatives: {legible(key)}: must be named once" for key in twice]
    if faults:
        raise InputError(*faults)


def _name_of_number(body: str, key: str) -> str:
    """Return the name that the law of a body has for a key, "" for a key that is not its own."""
    entry = layer_entry(key)
    if entry is not None and entry[0] == f"{body}.layers":
        return f"layers{entry[1]}.{entry[2].removeprefix('wear.')}"
    begin = f"wear.{body}."
    return key.removeprefix(begin) if key.startswith(begin) else ""


class Sensitivity:
    """What P numbers of a case, or of B cases that step together, act on directly.

    Parameters
    ----------
    keys : of the numbers.
    cases : one case, or several.
    pairs : of each.
    """

    def __init__(
        self, keys: Sequence[str], cases: Sequence[Case], pairs: Sequence[ContactPair]
    ) -> None:
        line, slope = pairs[0].line, pairs[0].slope
        self.keys, self._arm = tuple(keys), line.arm
        #: whether a last row is that of the end of the step, which then may be an interface's
        self.moving_ends = any(isinstance(law, LayeredLaw) for law in cases[0].laws)
        rows = {key: row for row, key in enumerate(keys)}
        #: rows and names of the parameters of the laws of lower and upper
        self._laws = tuple(
            [(row, name) for key, row in rows.items() if (name := _name_of_number(body, key))]
            for body in BODIES
        )
        #: of bodies, which number is the length of their averages, and what it does to these
        self.averages: dict[int, tuple[int, FloatArray]] = {}
        true_area = line.area * obliquity(slope)
        for body, (numbers, law) in enumerate(zip(self._laws, cases[0].laws, strict=True)):
            for row in [row for row, name in numbers if name == "length"]:
                assert law is not None
                self.averages[body] = row, d_averaging(line.r, true_area, law.length)
                numbers.remove((row, "length"))
        self.friction, self.omega = rows.get("contact.friction"), rows.get("load.omega")

        #: what mu and omega are, which tells how far differences may go
        self._sizes = {
            row: np.array([abs(number(case)) or 1.0 for case in cases])
            for row, number in (
                (self.friction, lambda case: case.friction),
                (self.omega, lambda case: case.load.omega),
            )
            if row is not None
        }
        #: (P, ...) derivatives of the force, N, or of the displacement, mm
        self.load = self.zeros(len(cases))
        for key, row in rows.items():
            if key == "load.pressure":
                self.load[row] = [case.area for case in cases]
            elif key in ("load.force", "load.displacement"):
                self.load[row] = 1.0
        elastic = {"lower.young", "upper.young", *elastic_numbers(cases[0])}
        self.elastic = [
            (row, _Elastic.of(cases, pairs, key)) for key, row in rows.items() if key in elastic
        ]
        rows_of_keys = [*keys, ""][: len(self)]
        #: of bodies with layers, (layers, P), which number is the thickness of which layer
        self.thicknesses = {
            i: np.array([[key == f"{body}.layers[{j}].thickness" for key in rows_of_keys]
                         for j in range(len(ring.layers))], dtype=float)
            for i, (body, ring) in enumerate(zip(BODIES, cases[0].rings, strict=True))
            if ring.layers
        }  # fmt: skip

    def __len__(self) -> int:
        return len(self.keys) + self.moving_ends

    def take(self, histories: IntArray) -> "Sensitivity":
        """Return the sensitivity of some of B histories."""
        taken = copy.copy(self)
        taken._sizes = {row: size[histories] for row, size in self._sizes.items()}
        taken.load = self.load[:, histories]
        taken.elastic = [(row, elastic.take(histories)) for row, elastic in self.elastic]
        return taken

    def zeros(self, *shape: int) -> FloatArray:
        """Return derivatives (P, ...) that are 0."""
        return np.zeros((len(self), *shape))

    def layer_starts(self, i: int, law: Law) -> FloatArray | float:
        """Return derivatives of the depths at which layers start, see ``VaryingNumbers``."""
        thicknesses = self.thicknesses.get(i)
        if thicknesses is None or not thicknesses.any() or not isinstance(law, LayeredLaw):
            return 0.0
        assert law.present is not None
        starts = np.concatenate([np.zeros_like(thicknesses[:1]), np.cumsum(thicknesses, axis=0)])
        return np.moveaxis(starts[law.present], -1, 0)

    def rates(self, i: int, law: Law, p: FloatArray, at: LocalState) -> FloatArray:
        """Return derivatives of rates with respect to the numbers, see ``VaryingNumbers``."""
        out = self.zeros(*p.shape)
        for row, name in self._laws[i]:
            if name in law.numeric:
                out[row] = law.d_rate_dparameter(name, p, at)
        if RATES[i] in self.keys:
            out[self.keys.index(RATES[i])] = law.rate(p, at)
        if self.friction is not None:
            size, still = columns(self._sizes[self.friction]), np.zeros(p.shape[-1])
            along = LocalState(0.0, at.r, still, size, still, still)
            out[self.friction] = law.d_rate_dlocal(p, at, along) / size
        if self.omega is not None:
            size, still = columns(self._sizes[self.omega]), np.zeros(p.shape[-1])
            turn = size * self._arm
            along = LocalState(0.0, at.r, turn, 0.0, still, at.time * turn)
            out[self.omega] = law.d_rate_dlocal(p, at, along) / size
        return out

    def add_gap(self, gap: FloatArray, p: FloatArray, at: FloatArray) -> None:
        """Add to derivatives of the gap, (P, ..., n) mm, of elasticity at given pressures.

        Parameters
        ----------
        p, at : (..., n) MPa, of a solution, and those that it was corrected at.
        """
        for row, elastic in self.elastic:
            products = RowProducts(elastic.which)
            gap[row] += products.of(p - at, elastic.symmetric)
            gap[row] += products.of(at, elastic.collocated)


@dataclass(frozen=True)
class _Elastic:
    """Derivatives with respect to a number of m compliances, of other pairs or moduli.

    Parameters
    ----------
    symmetric, collocated : (m, n, n) of K / m and C, transposed.
    twist : (m, n).
    which : (B,) int of each history, or 0.
    """

    symmetric: FloatArray
    collocated: FloatArray
    twist: FloatArray
    which: Any

    @classmethod
    def of(cls, cases: Sequence[Case], pairs: Sequence[ContactPair], key: str) -> "_Elastic":
        """Return the derivatives of some cases, each on its pair."""
        operators = [key_of(pair, young(case)) for pair, case in zip(pairs, cases, strict=True)]
        firsts = dict(zip(operators, zip(pairs, cases, strict=True), strict=True))
        places = {operator: place for place, operator in enumerate(firsts)}
        every = [
            pair.d_compliance(young(case), compliance_change(case, pair, key))
            for pair, case in firsts.values()
        ]
        area = pairs[0].line.area
        return cls(
            np.array([(matrix / area[:, None]).T for matrix, _, _ in every]),
            np.array([collocated.T for _, collocated, _ in every]),
            np.array([twist for _, _, twist in every]),
            np.array([places[operator] for operator in operators]),
        )

    def take(self, histories: IntArray) -> "_Elastic":
        """Return the derivatives of some of B histories."""
        return replace(self, which=self.which[histories])
