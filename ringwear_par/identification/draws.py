"""Draws of what a fit knows: a row is one possibility for the material, its tests and all sizes.

Predictions, plans and running tests read only these, from a fit or from its ``draws.nc``, which
ArviZ opens too.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError
from ringwear_par.identification.definition.fitted_parameters import units_of
from ringwear_par.identification.definition.problem import (
    PLURALS,
    FittedParameter,
    Problem,
    body_of_wear,
)
from ringwear_par.results.files import reading, write_variable
from ringwear_par.results.variables import SOFTWARE, Variable, axis
from ringwear_par.schedules import mean, mean_of_product

if TYPE_CHECKING:
    from ringwear_par.identification.solution import Solution

#: what draws may be for, besides the name of a specimen
NEXT, MATERIAL = "next specimen", "material"
#: axes of stored draws, and as how many chains they are stored, which ArviZ compares
CHAINED, _CHAINS = ("chain", "draw"), 4
#: names of variables: values of a key in tests, its scatter between groups, and random wear
_TESTS, _SCATTER, _PROCESS = "{} of tests", "scatter of {} between {}", "process.{}"
#: conditions of a test and their units
CONDITIONS = {"p": "MPa", "V": "mm/s", "pV": "MPa mm/s", "distance": "mm", "mu": "1"}


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws (s,) of the posterior of a fit, in no order."""

    #: the m fitted keys, without what was known of them before; and the units of the case
    parameters: Sequence[FittedParameter]
    units: Sequence[str]
    #: names of the tests, and of their specimens
    experiments: Sequence[str]
    specimens: Sequence[str]
    #: names of the laws by table of keys, see ``law_names``
    laws: Mapping[str, str]
    #: of the tests, see ``conditions_of``
    conditions: Sequence[Sequence[float]]
    #: (s, m) values of the material
    material: FloatArray
    #: (s, tests) values of the tests, by key, of those that scatter
    tests: Mapping[str, FloatArray]
    #: (s,) standard deviations of unknowns between groups, by key and "specimen", "batch" or "lab"
    scatter: Mapping[tuple[str, str], FloatArray]
    #: (s,) mm, sizes of the random wear of bodies that have it, by "wear.lower" and "wear.upper"
    process: Mapping[str, FloatArray]

    def __len__(self) -> int:
        return len(self.material)

    @property
    def keys(self) -> list[str]:
        """The fitted keys."""
        return [parameter.key for parameter in self.parameters]

    def values(
        self, of: str, count: int, random: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Return values (count, m), and sizes of the random wear (count, 2) mm; 0: none.

        Parameters
        ----------
        of : "next specimen", of a new batch and laboratory; "material"; or the name of a specimen.
        """
        rows = random.choice(len(self), count, count > len(self))
        values, sizes, keys = self.material[rows], np.zeros((count, 2)), self.keys
        if of == MATERIAL:
            return values, sizes
        for key, found in self.process.items():
            sizes[:, BODIES.index(body_of_wear(key))] = found[rows]
        if of in self.specimens:
            for key, of_tests in self.tests.items():
                values[:, keys.index(key)] = of_tests[rows, self.specimens.index(of)]
            return values, sizes
        for (key, _), sd in self.scatter.items():
            j, z = keys.index(key), random.standard_normal(count)
            x = self.parameters[j].unknown(values[:, j]) + sd[rows] * z
            values[:, j] = self.parameters[j].reflected_value(x)
        return values, sizes

    def ordered(self, problem: Problem) -> Problem:
        """Return a problem with its keys in the order of the fit's; InputError of other keys."""
        if {*problem.keys} != {*self.keys}:
            raise InputError(
                f"{problem.name}: fits {', '.join(problem.keys)}; must be {', '.join(self.keys)}, "
                "as the fit of earlier tests"
            )
        parameters = sorted(problem.parameters, key=lambda p: self.keys.index(p.key))
        return replace(problem, parameters=tuple(parameters))


def draws_of(solution: "Solution", material: FloatArray) -> Draws:
    """Return the draws of a solution, with values (s, m) of the material."""
    problem, posterior, theta = solution.problem, solution.posterior, solution.theta
    keys, tests = problem.keys, problem.experiments
    x, shares = problem.values(posterior.of_tests(theta)), posterior.shares(theta).T
    process = zip(problem.settings.process.items(), shares, solution.depths, strict=True)
    scatter = [(keys[s.key], s.levels.items()) for s in posterior.scatterings]
    return Draws(
        [FittedParameter(p.key, p.start, p.bounds, p.log) for p in problem.parameters],
        [*units_of(problem).values()], [test.name for test in tests],
        [test.groups[0] for test in tests], law_names(tests[0].case),
        [conditions_of(test.case, keys) for test in tests],
        material, {keys[s.key]: x[..., s.key] for s in posterior.scatterings},
        {(key, name): size(theta) for key, levels in scatter for name, size in levels},
        {key: np.full(len(theta), noise.size or share**2 * depth)
         for (key, noise), share, depth in process},
    )  # fmt: skip


def conditions_of(case: Case, keys: Sequence[str] = ()) -> list[float]:
    """Return means over a test of pressure, speed and their product, distance and friction.

    At the mean radius; NaN of what a displacement sets, and of friction that is among the keys.
    """
    end, radius = case.time.end, float(case.line.area @ case.line.r / case.line.area.sum())
    speed, pressure, product = radius * mean(case.load.omega, 0.0, end), np.nan, np.nan
    if (force := case.load.force) is not None:
        pressure = mean(force, 0.0, end) / case.area
        product = radius * mean_of_product(force, case.load.omega, 0.0, end) / case.area
    friction = np.nan if "contact.friction" in keys else mean(case.friction, 0.0, end)
    return [pressure, speed, product, speed * end, friction]


def law_names(case: Case) -> dict[str, str]:
    """Return the names of the laws of bodies and layers that wear, or their files, by table."""
    laws = case.laws_by_table.items()
    return {table: Path(law.code.called if law.code else law.name).name for table, law in laws}


def write_draws(group: h5py.Group, draws: Draws) -> None:
    """Write draws as ArviZ has the group ``posterior``. On one rank."""
    parameters = [(p.key, p.start, p.bounds, p.log) for p in draws.parameters]
    names = {name: [*getattr(draws, name)] for name in ("tests", "scatter", "process")}
    about = vars(draws) | names | {"parameters": parameters}
    del about["material"]
    group.attrs["fit"] = json.dumps(about)
    units = dict(zip(draws.keys, draws.units, strict=True))
    material = zip(draws.keys, draws.material.T, strict=True)
    write_columns(group, (*CHAINED, "test"), [
        *((key, values, units[key], "value of the material") for key, values in material),
        *((_TESTS.format(key), values, units[key], "value of the test's specimen")
          for key, values in draws.tests.items()),
        *((_SCATTER.format(key, PLURALS[level]), sd, "1", "standard deviation of the unknown")
          for (key, level), sd in draws.scatter.items()),
        *((_PROCESS.format(key), sizes, "mm", "size of the random wear")
          for key, sizes in draws.process.items()),
    ])  # fmt: skip


def write_columns(
    group: h5py.Group, axes: Sequence[str], columns: Iterable[tuple[str, Any, str, str]]
) -> None:
    """Write arrays, each with its name, unit and meaning, along the first of the axes or all.

    Draws (s, ...) become chains. Axes, numbered from 0, are written with the first array there.
    """
    for name, values, unit, meaning in columns:
        if axes[0] == CHAINED[0]:
            values = values.reshape(_CHAINS, -1, *values.shape[1:])
        variable = Variable(name, tuple(axes)[: np.ndim(values)], unit, meaning)
        for one, size in zip(variable.dimensions, np.shape(values), strict=True):
            if one not in group:
                write_variable(group, axis(one), np.arange(size))
        write_variable(group, variable, values)


def read_draws(path: Path) -> Draws:
    """Return the draws of a fit's folder from its ``draws.nc``.

    Raises
    ------
    InputError : the file is of anything else, or damaged.
    """
    with reading(path, SOFTWARE, "the draws of ringwear fit") as file:
        about = json.loads(file["posterior"].attrs["fit"])
        stored = {name: of[()] for name, of in file["posterior"].items() if of.ndim > 1}
        found = {name: of.reshape(-1, *of.shape[2:]) for name, of in stored.items()}
        about["parameters"] = [
            FittedParameter(key, start, tuple(bounds), log)
            for key, start, bounds, log in about["parameters"]
        ]
        about["tests"] = {key: found[_TESTS.format(key)] for key in about["tests"]}
        about["scatter"] = {
            (key, level): found[_SCATTER.format(key, PLURALS[level])]
            for key, level in about["scatter"]
        }
        about["process"] = {key: found[_PROCESS.format(key)] for key in about["process"]}
        material = np.stack([found[p.key] for p in about["parameters"]], axis=-1)
        return Draws(**about, material=material)
