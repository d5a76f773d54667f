"""Draws of what a fit knows: a row is one possibility for the material, its tests and all sizes.

Predictions, plans and running tests read only these, from a fit or from its ``draws.nc``, which
ArviZ opens too.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError
from ringwear_par.identification.definition.problem import PLURALS, Problem, body_of_wear, reflected
from ringwear_par.results.files import atomic_hdf5, reading, write_variable
from ringwear_par.results.variables import SOFTWARE, Variable, axis
from ringwear_par.schedules import mean, mean_of_product

#: what draws may be for, besides the name of a specimen
NEXT, MATERIAL = "next specimen", "material"
#: draws are stored as so many chains, which ArviZ compares
CHAINS = 4
#: name of the scatter of a key between groups
_SCATTER = "scatter of {} between {}"
#: conditions of a test and their units
CONDITIONS = {"p": "MPa", "V": "mm/s", "pV": "MPa mm/s", "distance": "mm", "mu": "1"}


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws (s,) of the posterior of a fit, in no order."""

    #: the m fitted keys, and their units
    keys: tuple[str, ...]
    units: tuple[str, ...]
    #: (m,) whether an unknown is a value's logarithm
    logarithmic: BoolArray
    #: (m, 2) of the values
    bounds: FloatArray
    #: (s, m) values of the material
    material: FloatArray
    #: (s, tests) values of the tests, by key, of those that scatter
    tests: Mapping[str, FloatArray]
    #: (s,) standard deviations of unknowns between groups, by key and "specimen", "batch" or "lab"
    scatter: Mapping[tuple[str, str], FloatArray]
    #: (s,) mm, sizes of the random wear of bodies that have it, by "wear.lower" and "wear.upper"
    process: Mapping[str, FloatArray]
    #: names of the tests, and of their specimens
    experiments: tuple[str, ...]
    specimens: tuple[str, ...]
    #: names of the laws by table of keys, see ``law_names``
    laws: Mapping[str, str]
    #: (tests, 5), see ``conditions_of``
    conditions: FloatArray

    def __len__(self) -> int:
        return len(self.material)

    def of_test(self, number: int) -> FloatArray:
        """Return the unknowns (s, m) of a test."""
        x = self.material.copy()
        for key, values in self.tests.items():
            x[:, self.keys.index(key)] = values[:, number]
        return self._unknowns(x)

    def unknowns(
        self, of: str, count: int, random: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Return unknowns (count, m), and sizes of the random wear (count, 2) mm; 0: none.

        Parameters
        ----------
        of : "next specimen", of a new batch and laboratory; "material"; or the name of a specimen.
        """
        rows, sizes = random.choice(len(self), count, count > len(self)), np.zeros((count, 2))
        x = self._unknowns(self.material[rows])
        if of == MATERIAL:
            return x, sizes
        for key, found in self.process.items():
            sizes[:, BODIES.index(body_of_wear(key))] = found[rows]
        if of in self.specimens:
            return self.of_test(self.specimens.index(of))[rows], sizes
        for (key, _), sd in self.scatter.items():
            x[:, self.keys.index(key)] += sd[rows] * random.standard_normal(count)
        return reflected(x, *self._unknowns(self.bounds.T)), sizes

    def _unknowns(self, values: FloatArray) -> FloatArray:
        """Return the unknowns of values (..., m)."""
        unknowns = np.array(values)
        unknowns[..., self.logarithmic] = np.log(unknowns[..., self.logarithmic])
        return unknowns

    def values(self, unknowns: FloatArray) -> FloatArray:
        """Return the values of unknowns (..., m), within the bounds to the last bit."""
        return values_of(unknowns, self.logarithmic, self.bounds)

    def ordered(self, problem: Problem) -> Problem:
        """Return a problem with its keys in the order of the fit's; InputError of other keys."""
        if {*problem.keys} != {*self.keys}:
            raise InputError(
                f"{problem.name}: fits {', '.join(problem.keys)}; must be {', '.join(self.keys)}, "
                "as the fit of earlier tests"
            )
        parameters = sorted(problem.parameters, key=lambda p: self.keys.index(p.key))
        return replace(problem, parameters=tuple(parameters))


def values_of(unknowns: FloatArray, logarithmic: BoolArray, bounds: FloatArray) -> FloatArray:
    """Return the values of unknowns (..., m), within bounds (m, 2) to the last bit."""
    values = np.array(unknowns)
    values[..., logarithmic] = np.exp(values[..., logarithmic])
    return np.clip(values, *bounds.T)


def conditions_of(case: Case, keys: Sequence[str] = ()) -> FloatArray:
    """Return means over a test of pressure, speed and their product, distance and friction, (5,).

    At the mean radius; NaN of what a displacement sets, and of friction that is among the keys.
    """
    end, radius = case.time.end, float(case.line.area @ case.line.r / case.line.area.sum())
    speed, pressure, product = radius * mean(case.load.omega, 0.0, end), np.nan, np.nan
    if (force := case.load.force) is not None:
        pressure = mean(force, 0.0, end) / case.area
        product = radius * mean_of_product(force, case.load.omega, 0.0, end) / case.area
    friction = np.nan if "contact.friction" in keys else mean(case.friction, 0.0, end)
    return np.array([pressure, speed, product, speed * end, friction])


def law_names(case: Case) -> dict[str, str]:
    """Return the names of the laws of bodies and layers that wear, or their files, by table."""
    laws = case.laws_by_table.items()
    return {table: Path(law.code.called if law.code else law.name).name for table, law in laws}


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
    by_chain = {"chain": CHAINS, "draw": len(draws) // CHAINS}
    with atomic_hdf5(path) as file:
        file.attrs.update({"software": SOFTWARE, **versions})
        group = file.create_group("posterior")
        group.attrs["fit"] = json.dumps({
            "keys": draws.keys, "units": draws.units, "logarithmic": draws.logarithmic.tolist(),
            "bounds": draws.bounds.tolist(), "tests": [*draws.tests], "scatter": [*draws.scatter],
            "process": [*draws.process], "experiments": draws.experiments,
            "specimens": draws.specimens, "laws": dict(draws.laws),
            "conditions": draws.conditions.tolist(),
        })  # fmt: skip
        units = dict(zip(draws.keys, draws.units, strict=True))
        material = zip(draws.keys, draws.material.T, strict=True)
        write_columns(group, {**by_chain, "test": len(draws.specimens)}, [
            *((key, values, units[key], "value of the material") for key, values in material),
            *((f"{key} of tests", values, units[key], "value of the test's specimen")
              for key, values in draws.tests.items()),
            *((_SCATTER.format(key, PLURALS[level]), sd, "1", "standard deviation of the unknown")
              for (key, level), sd in draws.scatter.items()),
            *((f"process.{key}", sizes, "mm", "size of the random wear")
              for key, sizes in draws.process.items()),
        ])  # fmt: skip
        for name, array in readings.items():
            axes = {**(by_chain if array.ndim > 1 else {}), "place": array.shape[-1]}
            group = file.create_group(name)
            write_columns(group, axes, [("reading", array, "1", name.replace("_", " "))])
            for place, entries in places.items():
                meaning = f"{place} of the reading"
                write_variable(group, Variable(place, ("place",), "1", meaning), [*entries])


def write_columns(
    group: h5py.Group,
    axes: Mapping[str, int],
    columns: Iterable[tuple[str, FloatArray, str, str]],
) -> None:
    """Write axes by their lengths, and variables along the first ones of them, or all."""
    for name, size in axes.items():
        write_variable(group, axis(name), np.arange(size))
    names, sizes = tuple(axes), tuple(axes.values())
    for name, values, unit, meaning in columns:
        count = values.ndim + ("chain" in axes)
        variable = Variable(name, names[:count], unit, meaning)
        write_variable(group, variable, values.reshape(sizes[:count]))


def read_draws(path: Path) -> Draws:
    """Return the draws of a fit's folder from its ``draws.nc``.

    Raises
    ------
    InputError : the file is of anything else, or damaged.
    """
    with reading(path, SOFTWARE, "the draws of ringwear fit") as file:
        group = file["posterior"]
        about = json.loads(group.attrs["fit"])

        def columns(name: str) -> FloatArray:
            values: FloatArray = group[name][()]
            return values.reshape(-1, *values.shape[2:])

        return Draws(
            tuple(about["keys"]), tuple(about["units"]), np.array(about["logarithmic"]),
            np.array(about["bounds"]), np.stack([*map(columns, about["keys"])], axis=-1),
            {key: columns(f"{key} of tests") for key in about["tests"]},
            {(key, level): columns(_SCATTER.format(key, PLURALS[level]))
             for key, level in about["scatter"]},
            {key: columns(f"process.{key}") for key in about["process"]},
            tuple(about["experiments"]), tuple(about["specimens"]), about["laws"],
            np.array(about["conditions"], dtype=float),
        )  # fmt: skip
