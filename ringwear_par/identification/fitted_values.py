"""Distributions of a fit's keys, from which predictions draw, stored in the fit's folder."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import h5py
import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.problem import body_of_wear
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.results.storage.hdf5 import write_variable
from ringwear_par.results.variables import PARAMETER, Variable
from ringwear_par.schedules import mean, mean_of_product
from ringwear_par.wear.law import WearLaw

#: group of results.h5, and that of groups of the laws compared, which have one each
GROUP, LAWS = "values", "laws"
#: conditions of a test and their units, and what keys each depends on
CONDITIONS = {"p": "MPa", "V": "mm/s", "pV": "MPa mm/s", "distance": "mm", "mu": "1"}
_SET_BY = {
    "p": ("load.force", "load.pressure"), "V": ("load.omega",), "mu": ("contact.friction",),
    "pV": ("load.force", "load.pressure", "load.omega"), "distance": ("load.omega", "time.end"),
}  # fmt: skip
#: probability of all parts of a mixture that are left out together, and of one in pieces
_IMPROBABLE, _OF_PIECES = 1e-9, 1e-5


@dataclass(frozen=True, eq=False)
class FittedValues:
    """Distributions of the fitted keys' unknowns: mixtures of normal ones over sizes of scatter."""

    #: the m fitted keys
    keys: tuple[str, ...]
    #: (m,) whether an unknown is a value's logarithm
    logarithmic: BoolArray
    #: (m, 2) of the values
    bounds: FloatArray
    #: (g,) of the parts of the mixtures; one without scatter
    weights: FloatArray
    #: (g, 1 + tests, m) and (g, 1 + tests, m, m) of the unknowns of the material and of each test;
    #: NaN where nothing is known
    means: FloatArray
    covariances: FloatArray
    #: (g, levels) sizes of the scatters
    scatters: FloatArray
    #: (levels,) number of the key of each
    scattering: IntArray
    #: (g, 2) mm, of the process noise of lower and upper; 0: none
    sizes: FloatArray
    #: of the tests, by name
    specimens: tuple[str, ...]
    #: names of the laws by table of keys, see ``law_names``
    laws: Mapping[str, str]
    #: (tests, 5), see ``conditions_of``
    conditions: FloatArray
    #: (s, m) values, of an ensemble's posterior; None: there are none
    samples: FloatArray | None = None


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

    Those of users have the beginning of their source's SHA-256 behind it.
    """
    return {table: _law_name(law) for table, law in case.laws_by_table.items()}


def _law_name(law: WearLaw | None) -> str:
    if law is None:
        return ""
    name, source = getattr(law, "name", "") or type(law).__name__, getattr(law, "source", "")
    return f"{name} {hashlib.sha256(source.encode()).hexdigest()[:12]}" if source else name


def fitted_values(fit: FitResult) -> FittedValues:
    """Return the distributions of a fit's keys."""
    problem, m, material = fit.misfit.problem, len(fit.parameters), fit.material
    tests = len(problem.experiments)
    if material is None:
        weights = np.ones(1)
        means = np.tile(fit.x[:m], (1, 1 + tests, 1))
        covariance = np.where(np.isfinite(fit.covariance), fit.covariance, np.nan)[:m, :m]
        covariances = np.tile(covariance, (1, 1 + tests, 1, 1))
        scatters, scattering = np.zeros((1, 0)), np.zeros(0, dtype=np.int64)
        sizes = np.zeros((1, len(BODIES)))
    else:
        free = np.array(material.mixed.free, dtype=np.int64)
        pieces = material.parts
        weights = np.concatenate([piece.weight * piece.posterior.weights for piece in pieces])
        order = np.argsort(-weights)
        likely = np.cumsum(weights[order]) < 1.0 - (_OF_PIECES if material.pieces else _IMPROBABLE)
        parts = order[: int(likely.sum()) + 1]
        weights = weights[parts] / weights[parts].sum()
        rows = np.vstack([fit.x[:m], material.test_unknowns])  # those at bounds stay there
        means = np.tile(rows, (len(parts), 1, 1))
        covariances = np.zeros((len(parts), 1 + tests, m, m))
        for place, test in enumerate([None, *range(tests)]):
            free_means = np.concatenate([piece.posterior.means_of(test) for piece in pieces])
            between = np.concatenate([piece.posterior.covariances_of(test) for piece in pieces])
            means[:, place, free] = free_means[parts]
            covariances[:, place, free[:, None], free] = between[parts]
        scatters = np.concatenate([piece.posterior.solutions.tau for piece in pieces])[parts]
        levels = [level.key for level in material.mixed.posterior.model.levels]
        scattering = free[np.array(levels, dtype=np.int64)]
        sizes = np.zeros((len(parts), len(BODIES)))
        wearing = [BODIES.index(body_of_wear(key)) for key in material.wear.process]
        shares = np.concatenate([piece.posterior.shares for piece in pieces])[parts]
        sizes[:, wearing] = material.wear.sizes(shares)
    return FittedValues(
        problem.keys, np.array([p.log for p in problem.parameters]),
        np.array([p.bounds for p in problem.parameters]), weights, means, covariances, scatters,
        scattering, sizes, tuple(e.groups[0] or e.name for e in problem.experiments),
        law_names(problem.experiments[0].case),
        np.array([conditions_of(e.case, problem.keys) for e in problem.experiments]),
        None if fit.posterior is None else fit.posterior.samples,
    )  # fmt: skip


#: arrays of the group: what they run over, their unit and meaning
_ARRAYS = {
    "logarithmic": (("parameter",), "whether the unknown is the logarithm of the value"),
    "bounds": (("parameter", "end"), "bounds of the value, in the key's unit"),
    "weights": (("part",), "probability of a part of the mixture"),
    "means": (("part", "place", "parameter"), "means of unknowns: of the material, then of tests"),
    "covariances": (
        ("part", "place", "parameter", "other_parameter"),
        "covariances of the unknowns",
    ),
    "scatters": (("part", "level"), "size of a scatter, in the unit of its unknown"),
    "scattering": (("level",), "number of the key of a scatter"),
    "sizes": (("part", "body"), "size of the process noise of lower and upper, mm"),
    "conditions": (("test", "condition"), f"means over a test: {', '.join(CONDITIONS)}"),
}


def write_values(file: h5py.Group, values: FittedValues) -> None:
    """Write a group of a file, or of a group of it."""
    group = file.create_group(GROUP)
    group.attrs.update(
        {
            "keys": list(values.keys),
            "specimens": list(values.specimens),
            "laws": list(values.laws.values()),
            "tables": list(values.laws),
        }
    )
    sizes: dict[str, int] = {}
    for name, (dimensions, _) in _ARRAYS.items():
        sizes |= dict(zip(dimensions, getattr(values, name).shape, strict=True))
    del sizes[PARAMETER.name]
    write_variable(group, PARAMETER, list(values.keys))
    for axis, size in sizes.items():
        write_variable(
            group, Variable(axis, (axis,), "1", f"number of the {axis}"), np.arange(size)
        )
    for name, (dimensions, meaning) in _ARRAYS.items():
        write_variable(group, Variable(name, dimensions, "1", meaning), getattr(values, name))


def read_values(file: h5py.Group) -> FittedValues:
    """Return the group of a file; KeyError or ValueError where there is none, or it is damaged."""
    group = file[GROUP]
    keys, specimens, laws, tables = (
        tuple(map(str, group.attrs[name])) for name in ("keys", "specimens", "laws", "tables")
    )
    arrays = {name: group[name][()] for name in _ARRAYS}
    samples = None
    if "posterior" in file:
        samples = np.stack([file["posterior"][key][()] for key in keys], axis=1)
    return FittedValues(
        keys=keys, specimens=specimens, laws=dict(zip(tables, laws, strict=True)),
        samples=samples, **arrays,
    )  # fmt: skip
