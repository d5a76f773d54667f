"""Draws of what a fit knows: a row is one possibility for the material, its tests and all sizes.

Predictions, plans and running tests read only these, from a fit or from its ``draws.nc``, which
ArviZ opens too.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.problem import reflected
from ringwear_par.results.files import atomic_hdf5, reading, write_variable
from ringwear_par.results.variables import SOFTWARE, Variable
from ringwear_par.schedules import mean, mean_of_product
from ringwear_par.wear.law import Law

#: what draws may be for, besides the name of a specimen
NEXT, MATERIAL = "next specimen", "material"
#: walkers of the sampler are stored as so many chains
CHAINS = 4
#: conditions of a test and their units, and what keys each depends on
CONDITIONS = {"p": "MPa", "V": "mm/s", "pV": "MPa mm/s", "distance": "mm", "mu": "1"}
_SET_BY = {
    "p": ("load.force", "load.pressure"), "V": ("load.omega",), "mu": ("contact.friction",),
    "pV": ("load.force", "load.pressure", "load.omega"), "distance": ("load.omega", "time.end"),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws (s,) of the posterior of a fit, in the order of its chains."""

    #: the m fitted keys, and their units
    keys: tuple[str, ...]
    units: tuple[str, ...]
    #: (m,) whether an unknown is a value's logarithm
    logarithmic: BoolArray
    #: (m, 2) of the values
    bounds: FloatArray
    #: (s, m) unknowns of the material
    material: FloatArray
    #: (s, tests, m) unknowns of the tests
    tests: FloatArray
    #: (s,) standard deviations of unknowns between groups, by key and "specimen", "batch" or "lab"
    scatter: Mapping[tuple[str, str], FloatArray]
    #: (s, 2) mm, size of the random wear of lower and upper; 0: none
    process: FloatArray
    #: of the tests, by name
    specimens: tuple[str, ...]
    #: names of the laws by table of keys, see ``law_names``
    laws: Mapping[str, str]
    #: (tests, 5), see ``conditions_of``
    conditions: FloatArray
    #: how many independent draws they are worth
    effective: float

    def __len__(self) -> int:
        return len(self.material)

    def unknowns(
        self, of: str, count: int, random: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Return unknowns (count, m), and sizes of the random wear (count, 2) mm.

        Parameters
        ----------
        of : "next specimen", of a new batch and laboratory; "material"; or the name of a specimen.
        """
        rows = random.choice(len(self), count, replace=count > len(self))
        if of in self.specimens:
            return self.tests[rows, self.specimens.index(of)], self.process[rows]
        x = self.material[rows]
        if of == MATERIAL:
            return x, np.zeros((count, len(BODIES)))
        for (key, _), sd in self.scatter.items():
            x[:, self.keys.index(key)] += sd[rows] * random.standard_normal(count)
        return reflected(x, *self.unknown_bounds), self.process[rows]

    @property
    def unknown_bounds(self) -> FloatArray:
        """Smallest and largest unknowns, (2, m)."""
        bounds: FloatArray = self.bounds.T.copy()
        bounds[:, self.logarithmic] = np.log(bounds[:, self.logarithmic])
        return bounds

    def values(self, unknowns: FloatArray) -> FloatArray:
        """Return the values of unknowns (..., m), within the bounds to the last bit."""
        values = np.array(unknowns)
        values[..., self.logarithmic] = np.exp(values[..., self.logarithmic])
        return np.clip(values, *self.bounds.T)


def conditions_of(case: Case, keys: Sequence[str] = ()) -> FloatArray:
    """Return means over a test of pressure, speed and their product, distance and friction, (5,).

    At the mean radius; NaN of what a displacement or one of the keys sets.
    """
    end, radius = case.time.end, float(case.line.area @ case.line.r / case.line.area.sum())
    force, omega = case.load.force, case.load.omega
    speed = radius * mean(omega, 0.0, end)
    numbers = {"p": np.nan, "V": speed, "pV": np.nan, "distance": speed * end}
    numbers["mu"] = mean(case.friction, 0.0, end)
    if force is not None:
        numbers["p"] = mean(force, 0.0, end) / case.area
        numbers["pV"] = radius * mean_of_product(force, omega, 0.0, end) / case.area
    unknown = [not {*keys}.isdisjoint(_SET_BY[name]) for name in CONDITIONS]
    return np.where(unknown, np.nan, [numbers[name] for name in CONDITIONS])


def law_names(case: Case) -> dict[str, str]:
    """Return the names of the laws of bodies and layers, "" of what does not wear, by their tables.

    User laws: the name and the first 12 hexadecimal digits of the source's SHA-256.
    """
    return {table: _law_name(law) for table, law in case.laws_by_table.items()}


def _law_name(law: Law | None) -> str:
    if law is None or law.code is None or not law.code.is_file:
        return "" if law is None else law.name
    return f"{law.name} {hashlib.sha256(law.code.source.encode()).hexdigest()[:12]}"


def write_draws(
    path: Path,
    draws: Draws,
    versions: Mapping[str, str],
    places: Mapping[str, Sequence[object]],
    readings: Mapping[str, FloatArray],
) -> None:
    """Write draws.nc, as ArviZ has its groups. On one rank.

    Parameters
    ----------
    places : "test", "series" and "at" (s or mm) of each reading, (n,).
    readings : "observed_data" (n,), and "posterior_predictive" and "log_likelihood" (s, n).
    """
    by_chain = (CHAINS, len(draws) // CHAINS)
    with atomic_hdf5(path) as file:
        file.attrs.update({"software": SOFTWARE, **versions})
        group = file.create_group("posterior")
        group.attrs["fit"] = json.dumps(
            {
                "keys": draws.keys, "units": draws.units, "logarithmic": draws.logarithmic.tolist(),
                "bounds": draws.bounds.tolist(), "scatter": [*draws.scatter],
                "specimens": draws.specimens,
                "laws": dict(draws.laws), "conditions": draws.conditions.tolist(),
                "effective": draws.effective,
            }
        )  # fmt: skip
        _axes(group, chain=CHAINS, draw=by_chain[1], test=len(draws.specimens))

        def put(name: str, values: FloatArray, unit: str, meaning: str, *more: str) -> None:
            variable = Variable(name, ("chain", "draw", *more), unit, meaning)
            write_variable(group, variable, values.reshape(*by_chain, *values.shape[1:]))

        values, of_tests = draws.values(draws.material), draws.values(draws.tests)
        for j, (key, unit) in enumerate(zip(draws.keys, draws.units, strict=True)):
            put(key, values[:, j], unit, "value of the material")
            if any(scattering == key for scattering, _ in draws.scatter):
                put(
                    f"{key} of tests",
                    of_tests[..., j],
                    unit,
                    "value of the test's specimen",
                    "test",
                )
        for (key, level), sd in draws.scatter.items():
            put(_scatter_name(key, level), sd, "1", "standard deviation of the unknown")
        for body, sizes in zip(BODIES, draws.process.T, strict=True):
            if sizes.any():
                put(f"process.wear.{body}", sizes, "mm", "size of the random wear")
        for name, array in readings.items():
            group = file.create_group(name)
            if array.ndim == 1:
                _axes(group, place=len(array))
                variable = Variable("reading", ("place",), "1", "what was read")
                write_variable(group, variable, array)
            else:
                _axes(group, chain=CHAINS, draw=by_chain[1], place=array.shape[-1])
                put("reading", array, "1", name.replace("_", " "), "place")
            for place, entries in places.items():
                meaning = f"{place} of the reading"
                write_variable(group, Variable(place, ("place",), "1", meaning), [*entries])


def _axes(group: h5py.Group, **sizes: int) -> None:
    for name, size in sizes.items():
        axis = Variable(name, (name,), "1", f"number of the {name}", integer=True)
        write_variable(group, axis, np.arange(size))


def _scatter_name(key: str, level: str) -> str:
    plural = "batches" if level == "batch" else f"{level}s"
    return f"scatter of {key} between {plural}"


def read_draws(path: Path) -> Draws:
    """Return the draws of a fit's folder from its ``draws.nc``.

    Raises
    ------
    InputError : the file is of anything else, or damaged.
    """
    with reading(path, SOFTWARE, "the draws of ringwear fit") as file:
        group = file["posterior"]
        about = json.loads(group.attrs["fit"])
        keys, scatter = tuple(about["keys"]), [(key, level) for key, level in about["scatter"]]
        logarithmic = np.array(about["logarithmic"])

        def column(name: str) -> FloatArray:
            values: FloatArray = group[name][()]
            return values.reshape(-1, *values.shape[2:])

        count, tests = column(keys[0]).size, len(about["specimens"])
        values, of_tests = np.empty((count, len(keys))), np.empty((count, tests, len(keys)))
        for j, key in enumerate(keys):
            values[:, j] = column(key)
            name = f"{key} of tests"
            of_tests[..., j] = column(name) if name in group else values[:, j, None]
        for unknowns in (values, of_tests):
            unknowns[..., logarithmic] = np.log(unknowns[..., logarithmic])
        process = np.zeros((count, len(BODIES)))
        for number, body in enumerate(BODIES):
            if f"process.wear.{body}" in group:
                process[:, number] = column(f"process.wear.{body}")
        return Draws(
            keys, tuple(about["units"]), logarithmic, np.array(about["bounds"]), values, of_tests,
            {(key, level): column(_scatter_name(key, level)) for key, level in scatter}, process,
            tuple(about["specimens"]), about["laws"], np.array(about["conditions"], dtype=float),
            about["effective"],
        )  # fmt: skip
