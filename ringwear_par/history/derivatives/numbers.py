"""How the numbers enter a history that it has derivatives with respect to."""

import copy
from collections.abc import Sequence

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, columns
from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import layer_entry
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.mesh import obliquity
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.history.derivatives.elastic_numbers import ElasticDerivatives
from ringwear_par.history.derivatives.keys import RATES, elastic_numbers
from ringwear_par.schedules import Quantity, Table, in_time
from ringwear_par.wear.law import Law
from ringwear_par.wear.laws.non_local import d_averaging
from ringwear_par.wear.layered import LayeredLaw
from ringwear_par.wear.local_state import LocalState


def _parameter_of_key(body: str, key: str) -> str:
    """Return the name of a key's parameter in the law of a body, "" for keys of anything else."""
    entry = layer_entry(key)
    if entry is not None and entry[0] == f"{body}.layers":
        return f"layers{entry[1]}.{entry[2].removeprefix('wear.')}"
    begin = f"wear.{body}."
    return key.removeprefix(begin) if key.startswith(begin) else ""


def _size(quantity: Quantity) -> float:
    """Return the size of a number, 1 of 0; 0 of a table."""
    return 0.0 if isinstance(quantity, Table) else abs(in_time(quantity, 0.0)) or 1.0


class Sensitivity:
    """Partial derivatives of loads, rates and elasticity of B histories by P numbers.

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
        #: whether the last row is of the end of the step, which an interface may set
        self.moving_ends = any(isinstance(law, LayeredLaw) for law in cases[0].laws)
        rows = {key: row for row, key in enumerate(keys)}
        #: rows and names of the parameters of the laws of lower and upper
        self._laws = tuple(
            [(row, name) for key, row in rows.items() if (name := _parameter_of_key(body, key))]
            for body in BODIES
        )
        #: by body: row of the length of its averages, and the derivatives of these by it
        self.averages: dict[int, tuple[int, FloatArray]] = {}
        true_area = line.area * obliquity(slope)
        for body, (numbers, law) in enumerate(zip(self._laws, cases[0].laws, strict=True)):
            for row in [row for row, name in numbers if name == "length"]:
                assert law is not None
                self.averages[body] = row, d_averaging(line.r, true_area, law.length)
                numbers.remove((row, "length"))
        self.friction, self.omega = rows.get("contact.friction"), rows.get("load.omega")

        #: |mu| and |omega|, by which their derivatives are scaled; 0 of tables, whose number is a
        #: factor
        self._sizes = {
            row: np.array([_size(number(case)) for case in cases])
            for row, number in (
                (self.friction, lambda case: case.friction),
                (self.omega, lambda case: case.load.omega),
            )
            if row is not None
        }
        #: (P, ...) derivatives of the force, N, or of the displacement, mm
        self._load = self.zeros(len(cases))
        for key, row in rows.items():
            if key == "load.pressure":
                self._load[row] = [case.area for case in cases]
            elif key in ("load.force", "load.displacement"):
                self._load[row] = 1.0
        #: row of the force; (B,) bool, whether its number is a factor on a table
        self._force = rows.get("load.force")
        self._is_table = np.array([isinstance(case.load.force, Table) for case in cases])
        elastic = {"lower.young", "upper.young", *elastic_numbers(cases[0])}
        self.elastic = [
            (row, ElasticDerivatives.of(cases, pairs, key))
            for key, row in rows.items()
            if key in elastic
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
        taken._load, taken._is_table = self._load[:, histories], self._is_table[histories]
        taken.elastic = [(row, elastic.take(histories)) for row, elastic in self.elastic]
        return taken

    def zeros(self, *shape: int) -> FloatArray:
        """Return derivatives (P, ...) that are 0."""
        return np.zeros((len(self), *shape))

    def d_friction(self, friction: FloatArray) -> FloatArray:
        """Return the derivative (B,) of mu (B,) by the number, or by the factor on its table."""
        assert self.friction is not None
        return np.where(self._sizes[self.friction] > 0.0, 1.0, friction)

    def d_omega(self, omega: FloatArray) -> FloatArray:
        """Return the derivative (B,) of speeds (B,) rad/s, as ``d_friction``."""
        assert self.omega is not None
        return np.where(self._sizes[self.omega] > 0.0, 1.0, omega)

    def load(self, force: Quantity | None, time: FloatArray) -> FloatArray:
        """Return derivatives (P, B) of forces, N, or displacements, mm, at times (B,)."""
        if self._force is None or force is None or not self._is_table.any():
            return self._load
        load = self._load.copy()
        load[self._force] = np.where(self._is_table, in_time(force, time), 1.0)
        return load

    def layer_starts(self, i: int, law: Law) -> FloatArray | float:
        """Return the derivatives of the depths at which layers start, (P, ..., n) mm, or 0.

        Along the axis, of the layers of body i that elements are in.
        """
        thicknesses = self.thicknesses.get(i)
        if thicknesses is None or not thicknesses.any() or not isinstance(law, LayeredLaw):
            return 0.0
        assert law.present is not None
        starts = np.concatenate([np.zeros_like(thicknesses[:1]), np.cumsum(thicknesses, axis=0)])
        return np.moveaxis(starts[law.present], -1, 0)

    def rates(self, i: int, law: Law, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the derivatives of the rate of body i, (P, ..., n), at given pressure and wear."""
        out = self.zeros(*p.shape)
        for row, name in self._laws[i]:
            if name in law.numeric:
                out[row] = law.d_rate_dparameter(name, p, at)
        if RATES[i] in self.keys:
            out[self.keys.index(RATES[i])] = law.rate(p, at)
        zero = np.zeros(p.shape[-1])
        if self.friction is not None:
            size = columns(self._sizes[self.friction])
            friction = np.where(size > 0.0, size, at.friction)
            direction = LocalState(0.0, at.r, zero, friction, zero, zero)
            d_rate = law.d_rate_dlocal(p, at, direction)
            out[self.friction] = d_rate / np.where(size > 0.0, size, 1.0)
        if self.omega is not None:
            size = columns(self._sizes[self.omega])
            speed = np.where(size > 0.0, size * self._arm, at.speed)
            slid = np.where(size > 0.0, at.time * speed, at.slid)
            direction = LocalState(0.0, at.r, speed, 0.0, zero, slid)
            d_rate = law.d_rate_dlocal(p, at, direction)
            out[self.omega] = d_rate / np.where(size > 0.0, size, 1.0)
        return out

    def add_gap(self, gap: FloatArray, p: FloatArray, at: FloatArray) -> None:
        """Add to derivatives of the gap, (P, ..., n) mm, of elasticity at given pressures.

        Parameters
        ----------
        p, at : (..., n) MPa, of a solution, and those that it was corrected at.
        """
        for row, elastic in self.elastic:
            elastic.add_gap(gap[row], p, at)
