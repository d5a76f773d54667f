"""The keys of a fit file, for those who write one: ``ringwear info --schema fit``."""

import math
from typing import Any, NamedTuple, get_args

from ringwear_par.cases.schema import keys_told
from ringwear_par.cases.values import number, pair, some_of, whole
from ringwear_par.identification.definition.candidates import COUNTS, CRITERIA, MOST_EXPERIMENTS
from ringwear_par.identification.definition.densities import DENSITIES
from ringwear_par.identification.definition.fit_file import INTERVALS, MOST_SAMPLES, MOST_STARTS
from ringwear_par.identification.definition.fitted import SCALES
from ringwear_par.identification.definition.planned import instants
from ringwear_par.identification.definition.problem import Loss, Method, Settings, Space
from ringwear_par.identification.definition.series import NUISANCES, QUANTITIES


class FitKey(NamedTuple):
    """One key of a fit file.

    Parameters
    ----------
    path : its dotted name, tables of a list without their number; KEY, NAME and KIND are users'.
    unit : "data's" for that of the readings.
    default : ... where the key must be given, None where there is none.
    """

    path: str
    unit: str
    default: Any
    meaning: str
    allowed: str


def _one_of(names: tuple[str, ...]) -> str:
    return "one of " + ", ".join(f'"{name}"' for name in names)


_PRIOR = "{ normal = [mean, sd] }, sd > 0"
_COLUMNS = 'texts for "time" and "value"; of a profile for "r" and "value"'
_USUAL, _SPACE = Settings(), Space()


#: unit and meaning of errors that are fitted along
_ERRORS = {
    "offset": ("data's", "constant error of all readings"),
    "drift": ("data's", "error that grows in proportion to time: what it is at the end"),
    "compliance": ("data's/kN", "of the machine: error over the load, of a penetration over what "
                   "that has changed"),
    "level": ("data's", "constant error of all depths"),
    "tilt": ("data's/mm", "error over the distance from the middle of the contact"),
}  # fmt: skip
#: of keys that vary between next tests
_VARIED = {
    "load.pressure": ("MPa", "mean pressure"),
    "load.force": ("N", "axial force, instead"),
    "load.omega": ("rad/s", "angular speed"),
    "time.end": ("s", "duration"),
    "load.steps": ("-", "loads of one test, growing, for equal times"),
    "profiles": ("-", "profiles of one test; at equal intervals unless profile.at says when"),
    "profile.at": ("1", "instants of these profiles, parts of the test"),
}


def _read_with(kind: str) -> str:
    return ", ".join(quantity for quantity, kinds in NUISANCES.items() if kind in kinds)


def _allowed(key: str) -> str:
    if key in COUNTS:
        return f"[lowest, highest], two whole numbers from 1 to {COUNTS[key]}"
    most = " and at most 1" if key == "profile.at" else ""
    return f"[lowest, highest], two numbers above 0{most}"


_FITTED = "fit.parameters.KEY"
_DATA = "experiment.data"
KEYS: tuple[FitKey, ...] = (
    FitKey("case", "-", ..., "the tests' case; experiments set what differs",
           "the name of a case file, relative to this one; in Python a dict too"),
    FitKey(f"{_FITTED}.start", "KEY's", ..., "where the search of a case key begins, what a dry "
           "run and a design take it to be; KEY is a number of a wear law, contact.friction, a "
           "load, load.omega or a modulus", "a number within the bounds"),
    FitKey(f"{_FITTED}.bounds", "KEY's", ..., "between which it is sought",
           pair(-math.inf).allowed),
    FitKey(f"{_FITTED}.scale", "-", "linear", "log: its logarithm is sought", _one_of(SCALES)),
    FitKey(f"{_FITTED}.prior", "KEY's", None, "what is known of it without these readings", _PRIOR),
    FitKey("fit.starts", "-", _USUAL.starts, "searches: from the starts given, the others from "
           "Sobol' points within the bounds", whole(1, MOST_STARTS).allowed),
    FitKey("fit.method", "-", _USUAL.method, "brgn: TAO's regularised Gauss-Newton; lm: SciPy's "
           "least_squares", _one_of(get_args(Method))),
    FitKey("fit.intervals", "-", list(_USUAL.intervals), "by covariance, by the profile of the "
           "likelihood, by samples of the posterior (pip install emcee); linear ones are always "
           "told", some_of(*INTERVALS).allowed),
    FitKey("fit.samples", "-", _USUAL.samples, "of the posterior", whole(1, MOST_SAMPLES).allowed),
    FitKey("fit.level", "1", _USUAL.level, "of the intervals", number(0.5, 1.0).allowed),
    FitKey("fit.loss", "-", _USUAL.loss, "student: noise with 4 degrees of freedom, where there "
           "are outliers", _one_of(get_args(Loss))),
    FitKey("experiment.name", "-", ..., "of the test", "a text that no other experiment has"),
    FitKey("experiment.set", "-", None, "case keys of this test", "a table of case keys and their "
           "values; none that is fitted"),
    FitKey(f"{_DATA}.quantity", "-", ..., "what was read; depths, penetrations, masses and volumes "
           "are positive where material is lost; points of a profile outside the contact are "
           "unworn", _one_of(QUANTITIES)),
    FitKey(f"{_DATA}.file", "-", None, "table of readings: a line of column names, then numbers; "
           "lines that begin with # and empty cells are skipped; times may be clock times: "
           "h:mm:ss, or min:s (h:min where units.time is h)",
           "the name of a text file with commas, semicolons or tabs, relative to this one"),
    FitKey(f"{_DATA}.columns", "-", None, "names of its columns, where they are not time (or r) "
           "and value", _COLUMNS),
    FitKey(f"{_DATA}.units", "-", None, "units of its columns, as pint knows them; default: "
           "those in the columns' names, as in z_um or z / um, which they must not contradict; "
           "else s, mm, N mm, g, mm^3", _COLUMNS),
    FitKey(f"{_DATA}.value", "data's", None, "a single reading, instead of file",
           number(-math.inf).allowed),
    FitKey(f"{_DATA}.unit", "-", None, "unit of value, or of sd where readings are planned",
           "a unit that pint knows, of the quantity"),
    FitKey(f"{_DATA}.at", "s", None, "time of a profile, or of a value; default: the end of the "
           "test", "a number within the test"),
    FitKey(f"{_DATA}.times", "s", None, "planned readings, instead of file; for --dry-run and "
           "ringwear design only", instants().allowed),
    FitKey(f"{_DATA}.r", "mm", None, "planned readings of a profile, likewise", instants().allowed),
    FitKey(f"{_DATA}.density", "g/mm3", None, "of all that the weighed body has lost, its layers "
           "included; default: those of the case, of the body and each of its layers (a mass must "
           "have them)",
           "a number from {:g} to {:g}".format(*DENSITIES)),
    FitKey(f"{_DATA}.sd", "data's", ..., "standard deviation of the readings' noise",
           'a number > 0; a column of file; { relative = x } of the readings (of their running '
           'median); "fit", which finds it'),
    FitKey(f"{_DATA}.correlation_time", "s", 0.0, "over which noise is correlated (AR(1)); not of "
           "a profile", "a number >= 0, at most 100 times the test"),
    FitKey(f"{_DATA}.exclude", "s or mm", None, "readings left out: of a profile from radius to "
           "radius, else from time to time", "a list of increasing pairs"),
    *(FitKey(f"{_DATA}.nuisance.{kind}", unit, None, f"{meaning} (of {_read_with(kind)})",
             "a table of prior and bounds, {} where nothing is known of it")
      for kind, (unit, meaning) in _ERRORS.items()),
    FitKey(f"{_DATA}.nuisance.KIND.prior", "KIND's", None, "what is known of it", _PRIOR),
    FitKey(f"{_DATA}.nuisance.KIND.bounds", "KIND's", None, "between which it is",
           pair(-math.inf).allowed),
    FitKey("compare.NAME.set", "-", None, "case keys of another law for the same readings, fitted "
           "with --compare", "a table of case keys and their values"),
    FitKey("compare.NAME.parameters", "-", ..., "its fitted keys", "as fit.parameters"),
    FitKey("design.criterion", "-", _SPACE.criterion, "of the next tests: D, smallest volume of "
           "the confidence ellipsoid; A, smallest mean variance over the widths of the bounds; "
           "eig, largest expected gain of information (needs priors or --after)",
           _one_of(CRITERIA)),
    *(FitKey(f"design.vary.{key}", unit, None, meaning, _allowed(key))
      for key, (unit, meaning) in _VARIED.items()),
    FitKey("design.budget.time.end", "s", None, "of all next tests together", number(0.0).allowed),
    FitKey("design.budget.experiments", "-", _SPACE.experiments, "how many tests come next",
           whole(1, MOST_EXPERIMENTS).allowed),
)  # fmt: skip


def schema() -> str:
    """Return every key with its unit, default and meaning, and what is allowed below each."""
    return keys_told(KEYS)
