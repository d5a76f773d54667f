"""The keys of a fit file: one list that reading, messages and ``info --schema fit`` follow."""

import math
from collections.abc import Mapping
from functools import cache
from typing import Any, get_args

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.tables import Key, TableReader, file_keys, keys_of_table
from ringwear_par.cases.values import (
    Reader,
    RejectedError,
    Values,
    anything,
    entries,
    increasing,
    number,
    of_type,
    one_of,
    pair,
    text,
    whole,
)
from ringwear_par.errors import legible
from ringwear_par.files.smoothing import MOST_POINTS
from ringwear_par.files.text import toml_value
from ringwear_par.identification.definition.problem import (
    PLURALS,
    QUANTITIES,
    READING_KINDS,
    Criterion,
    DesignSpace,
    Loss,
    Prior,
    Settings,
)

#: fewest readings of what a rig measures of a case in time
FEWEST_READINGS = 10
#: g/mm3: foams have more, osmium has less
DENSITIES = (1e-5, 0.03)
_MOST_EXPERIMENTS, _MOST_READINGS = 6, 100_000


def _instants() -> Values:
    """Return lists of increasing numbers, and equal steps from one to another."""

    def read(value: Any) -> FloatArray:
        if isinstance(value, Mapping) and value.keys() == {"from", "to", "count"}:
            low, high = pair(-math.inf).read([value["from"], value["to"]])
            return np.linspace(low, high, whole(2, _MOST_READINGS).read(value["count"]))
        return np.array(increasing(value, number(-math.inf).read, 1, _MOST_READINGS))

    allowed = (
        "{ from = a, to = b, count = n } with a < b and n from 2 to "
        f"{_MOST_READINGS}, or a list of increasing numbers"
    )
    return Values("times", read, allowed)


def _only(name: str, read: Reader, allowed: str) -> Values:
    """Return tables of one key."""

    def value_of(value: Any) -> Any:
        if not isinstance(value, Mapping) or value.keys() != {name}:
            raise RejectedError
        return read(value[name])

    return Values("any", value_of, f"{{ {name} = {allowed}")


def _prior(low: float, allowed: str) -> Values:
    """Return normal distributions whose mean is above a number."""

    def read(value: Any) -> Prior:
        mean, sd = entries(value, lambda entry: entry, 2, 2)
        return Prior(number(low).read(mean), number(0.0).read(sd))

    return _only("normal", read, f"[mean, sd] }}, two numbers{allowed}")


def _number_or(*words: str, allowed: str) -> Values:
    """Return numbers > 0, and words instead of one."""
    return Values("any", lambda v: v if v in words else number(0.0).read(v), allowed)


def _column_keys(table: str) -> tuple[Key, ...]:
    """Return the keys of readings about the columns of their file, and what of it is left out."""
    texts = anything('texts for "time" and "value"; of a profile for "r" and "value"')
    return (
        Key(f"{table}.columns", *texts, "-",
            "names of the columns of file; default: time (or r) and value", None),
        Key(f"{table}.units", *texts, "-",
            "units of the columns of file, as pint writes them; default: the units in the columns' "
            "names (z_um, z / um), which must agree; one of the two must be given", None),
        *file_keys(table),
        Key(f"{table}.exclude", *anything("a list of increasing pairs"), "s or mm",
            "pairs of times (of radii for a profile) between which readings are left out", None),
    )  # fmt: skip


_PRIOR, _POSITIVE = _prior(-math.inf, ", sd > 0"), _prior(0.0, " > 0")
_FACTOR = _only("prior", _POSITIVE.read, "{ normal = [mean, sd] } }, two numbers > 0")
_HALF_T = _only("half_t", number(0.0).read, "scale }, a number > 0")
_SIZE = _number_or("fit", allowed='"fit", or a number > 0')
_SMOOTHING = _number_or("auto", "none", allowed='"auto", "none", or a time > 0')
_DENSITY = number(*DENSITIES, ends=True)._replace(
    allowed="from {:g} to {:g} g/mm3, as of foams and metals".format(*DENSITIES)
)
_NOISE = number(0.0)._replace(
    allowed='a number > 0, the name of a column of file, { relative = x } or "fit"'
)
_FLAG = Values("any", of_type(bool), "true or false")
_TABLE = text("the name of a table: a text file with commas, semicolons or tabs")
_CASE_KEYS = anything("a table of case keys and their values")
_BOUNDS, _RANGE, _OF_SCATTER = pair(-math.inf), pair(1e-6), 'KEY\'s; 1 where scale = "log"'
_USUAL, _SPACE = Settings(), DesignSpace()
#: unit and meaning of nuisances
_ERRORS = {
    "offset": ("data's", "constant error of all readings"),
    "drift": ("data's", "error at the end of the test that has grown in proportion to time"),
    "compliance": ("data's/kN", "compliance of the machine: error over the load, for a penetration "
                   "over the change of the load since the start"),
    "level": ("data's", "constant error of all depths"),
    "tilt": ("data's/mm",
             "tilt of the profile: error over the distance from the middle of the contact"),
}  # fmt: skip


def _quantities_with(kind: str) -> str:
    return ", ".join(
        name for name, reading_kind in READING_KINDS.items() if kind in reading_kind.nuisances
    )


KEYS: tuple[Key, ...] = (
    Key("case", *text("the name of a case file, relative to this one; in Python a dict too"), "-",
        "case of all tests; experiment.set changes its keys for one test"),
    Key("fit.parameters.KEY.start", *number(-math.inf), "KEY's",
        "value, within the bounds, at which the search for a case key begins, and which a dry run "
        "and a design take as true without a prior; KEY is a number of a wear law, "
        "contact.friction, a load, load.omega, a modulus or a layer's thickness"),
    Key("fit.parameters.KEY.bounds", *_BOUNDS, "KEY's", "smallest and largest value of the search"),
    Key("fit.parameters.KEY.scale", *one_of("linear", "log"), "-",
        "log: the logarithm of the key is fitted", "linear"),
    Key("fit.parameters.KEY.prior", *_PRIOR, "KEY's",
        "what is known of the key without these readings: a normal distribution", None),
    Key("fit.parameters.KEY.scatter", *anything('"fit", a number > 0, or a table'), "-",
        "scatter of the key between specimens: \"fit\", a known standard deviation, or a table of "
        "these for specimen, batch and lab", None),
    *(Key(f"fit.parameters.KEY.scatter.{group}", *_SIZE, _OF_SCATTER,
          f"standard deviation between {groups} (of the logarithm where scale = \"log\")", None)
      for group, groups in PLURALS.items()),
    Key("fit.parameters.KEY.scatter.prior", *_HALF_T, _OF_SCATTER,
        "scale of the half-t prior (4 degrees of freedom) of fitted scatter; default 0.3 where "
        "scale = \"log\", else required", None),
    Key("fit.parameters.KEY.scatter.start", *number(0.0), _OF_SCATTER,
        "size of a fitted scatter that --dry-run and design take as true; default: half the scale "
        "of the prior", None),
    Key("fit.process.KEY", *anything('"fit", or a table'), "-",
        "noise of the wear itself, KEY is wear.lower or wear.upper: worn depth grows at random "
        "(gamma process), with a variance of size times mean depth", None),
    Key("fit.process.KEY.size", *_SIZE._replace(allowed='"fit", or a length > 0'), "mm",
        "size of the noise of wear: variance of the worn depth over its mean, or \"fit\"", None),
    Key("fit.process.KEY.share", *number(0.0, 1.0), "1",
        "instead of size: standard deviation of the worn depth over its mean, at the end of the "
        "test that wears most", None),
    Key("fit.process.KEY.prior", *_HALF_T, "1",
        "scale of the half-t prior (4 degrees of freedom) of the share where size = \"fit\"; "
        "default 0.1", None),
    Key("fit.units.KEY", *anything("a unit that pint knows, of the key"), "-",
        "unit in which the key is reported beside the case's; default: the one in which its start "
        "is written", None),
    Key("fit.level", *number(0.5, 1.0), "1", "confidence level of the intervals", _USUAL.level),
    Key("fit.loss", *one_of(*get_args(Loss)), "-",
        "distribution of the noise: gaussian, or student (4 degrees of freedom) against outliers",
        _USUAL.loss),
    Key("experiment.name", *text("a text, its name"), "-",
        "name of the test; names must differ"),
    *(Key(f"experiment.{group}", *text("a text"), "-", meaning, None)
      for group, meaning in (
          ("specimen", "its specimen; tests of one share its values; default: the test's name"),
          ("batch", "batch of the specimen; default: one for all"),
          ("lab", "laboratory of the specimen; default: one for all"))),
    Key("experiment.set", *_CASE_KEYS, "-",
        "case keys that differ in this test; no fitted ones", None),
    Key("experiment.input.key",
        *one_of("contact.friction", "load.force", "load.pressure", "load.omega"), "-",
        "case key whose values in time a rig measured; set and fit.parameters must not have it, "
        "nor experiment.data the torque of a friction"),
    Key("experiment.input.quantity", *one_of("torque"), "-",
        "torque, for contact.friction: mu is torque/(force r), r the mean radius of the pressures "
        "of the model's history; must be absent for other keys", None),
    Key("experiment.input.file", *_TABLE, "-",
        f"table of at least {FEWEST_READINGS} readings that cover 95 % of the test"),
    *_column_keys("experiment.input"),
    Key("experiment.input.smooth", *_SMOOTHING, "s",
        "auto: a smoothing spline, denser early in the test, its knots and penalty by "
        "generalised cross-validation; a time: a smoothing spline that halves waves of this "
        f"period; none: linear between the readings, {MOST_POINTS} at most", "auto"),
    Key("experiment.input.scale", *_FACTOR, "1",
        "calibration: what is known of a factor on the readings, which is estimated; default: they "
        "are exact", None),
    Key("experiment.data.quantity", *one_of(*QUANTITIES), "-",
        "measured quantity. Depths, penetrations, masses and volumes are positive where material "
        "is lost; profile points outside the contact count as unworn; through is the time at which "
        "the first layer of a body is worn through anywhere (value)"),
    Key("experiment.data.file", *_TABLE, "-",
        "table of readings, relative to this file: a line of column names, perhaps a row of "
        "units, then numbers. Lines above the names, lines that begin with #, and cells that are "
        "empty or nan, n.a., n/a, NA, -, --- are skipped. Times may be dates with times "
        "(2026-03-14 08:15:00, 14.03.2026 08:15:00) or clock times: h:mm:ss, or h:min where "
        "units.time is h, min:s where it is min", None),
    *_column_keys("experiment.data"),
    Key("experiment.data.value", *number(-math.inf), "data's",
        "a single reading, instead of file; perhaps with its unit (\"6.1 mg\")", None),
    Key("experiment.data.unit", *anything("a unit that pint knows, of the quantity"), "-",
        "unit of value and sd, where value has none; with planned readings, of sd", None),
    Key("experiment.data.at", *number(0.0), "s",
        "time in the test at which the profile or value was measured; default: the end", None),
    *(Key(f"experiment.data.{name}", *_instants(), unit,
          f"{what}, instead of file; for --dry-run and ringwear design only", None)
      for name, unit, what in (("times", "s", "times of planned readings"),
                               ("r", "mm", "radii of a planned profile"))),
    Key("experiment.data.density", *_DENSITY, "g/mm^3",
        "one density of all that the weighed body has lost, layers included; default: the "
        "densities of the body and its layers in the case. A mass needs one or the other", None),
    Key("experiment.data.sd", *_NOISE, "data's",
        "standard deviation of the readings' noise; that of a column of file is in its own unit, "
        "or the data's; \"fit\" estimates it"),
    Key("experiment.data.sd.relative", *number(0.0), "1",
        "sd as a share of the running median of the readings"),
    Key("experiment.data.correlation_time", *number(0.0, ends=True), "s",
        "correlation time of the noise (AR(1)), at most 100 times the test; not for profiles", 0.0),
    Key("experiment.data.censored", *text("below, above, or the name of a column of file"), "-",
        "readings of which only a limit is known: below, the true value is at most the reading; "
        "above, at least; or a column with these words, empty where the reading is a value", None),
    *(Key(f"experiment.data.nuisance.{kind}",
          *anything("a table of prior and bounds, {} where nothing is known of the nuisance"), unit,
          f"{meaning} (for {_quantities_with(kind)})", None)
      for kind, (unit, meaning) in _ERRORS.items()),
    Key("experiment.data.nuisance.KIND.prior", *_PRIOR, "KIND's",
        "what is known of the nuisance without these readings: a normal distribution", None),
    Key("experiment.data.nuisance.KIND.bounds", *_BOUNDS, "KIND's",
        "smallest and largest value of the nuisance", (-math.inf, math.inf)),
    Key("experiment.data.nuisance.thermal", *anything("a table of time and amplitude"), "-",
        "growth of rig and rings that warm up, amplitude (1 - exp(-t/time)), t from the start of "
        f"the test (for {_quantities_with('thermal')})", None),
    Key("experiment.data.nuisance.thermal.amplitude", *anything("a table of prior and bounds"),
        "data's", "growth in the end, negative where rings grow; default: nothing is known", None),
    Key("experiment.data.nuisance.thermal.power", *_FLAG, "-",
        "whether growth goes with the friction power mu F omega: each change of it makes a growth "
        "of its own, and amplitude is that of the largest power of the test. Needs load.control = "
        "\"force\"", False),
    Key("experiment.data.nuisance.thermal.time", *anything("a table of start, prior and bounds"),
        "s", "time constant of the growth; needs start, and prior or bounds"),
    Key("experiment.data.nuisance.thermal.time.start", *number(0.0), "s",
        "time constant at which the search begins"),
    Key("experiment.data.nuisance.thermal.time.prior", *_POSITIVE, "s",
        "what is known of the time constant without these readings: a normal distribution", None),
    Key("experiment.data.nuisance.thermal.time.bounds", *_RANGE, "s",
        "smallest and largest time constant; default: four sd of the prior from its mean, and "
        "at least a hundredth of that", None),
    Key("tests.file", *_TABLE, "-",
        "table of the laboratory, relative to this file, instead of [[experiment]]s or beside "
        "them: a row a test, whose first column is its name; columns of conditions, texts and "
        "masses, with their units in their names (F / N) or in a row below. Several rows of one "
        "name are weighings of one test, each with its time (at)"),
    *file_keys("tests"),
    Key("tests.columns", *anything("texts for name, specimen, batch, lab, at, censored, before, "
        "after, loss, sd (of a body: loss.lower) and case keys"), "-",
        "names of the columns of file; default: usual names, such as force, load, F, Last; "
        "pressure, p; speed, n, Drehzahl; duration, Dauer; specimen, batch, lab; before, after, "
        "loss and sd (of the loss) of masses; censored (below or above) of those that are limits; "
        "and the names of case keys", None),
    Key("tests.units", *anything("as tests.columns"), "-",
        "units of the columns of file, as pint writes them; default: those in the columns' names. "
        "A column named as a case key may have none: its cells are as in a case file", None),
    Key("tests.sd", *number(0.0), "g",
        "standard deviation of one weighing, with its unit (\"0.1 mg\"), where no column sd has "
        "that of the loss; a loss is of two weighings", None),
    Key("tests.data", *anything("tables, as experiment.data"), "-",
        "further readings of all tests; {COLUMN} in a text is the cell of that column, and a test "
        "where it is empty has no such readings: file = \"{record}\"; a cell alone is a number "
        "where it looks like one, and censored may be empty", None),
    Key("tests.input", *anything("tables, as experiment.input"), "-",
        "measured inputs of all tests, as tests.data", None),
    Key("compare.NAME.set", *_CASE_KEYS, "-",
        "case keys of another law for the same readings, fitted with --compare", None),
    Key("compare.NAME.parameters", *anything("as fit.parameters"), "-",
        "fitted keys of the other law"),
    Key("design.criterion", *one_of(*get_args(Criterion)), "-",
        "criterion for the next tests: D, smallest volume of the confidence ellipsoid; A, smallest "
        "mean variance, in widths of the bounds", _SPACE.criterion),
    Key("design.vary.load.pressure", *_RANGE, "MPa", "mean pressure", None),
    Key("design.vary.load.force", *_RANGE, "N", "axial force, instead of the mean pressure", None),
    Key("design.vary.load.omega", *_RANGE, "rad/s", "angular speed", None),
    Key("design.vary.time.end", *_RANGE, "s", "duration", None),
    Key("design.budget.time.end", *number(0.0), "s", "total duration of the next tests", None),
    Key("design.budget.experiments", *whole(1, _MOST_EXPERIMENTS), "-", "number of next tests",
        _SPACE.experiments),
)  # fmt: skip


@cache
def keys_of(name: str) -> dict[str, Key]:
    """Return the keys of a table by their names in it."""
    return keys_of_table(KEYS, name)


def reader_of(name: str, place: str, table: Any, faults: list[str]) -> TableReader:
    """Return the reader of a table of this dotted name, see ``TableReader``."""
    return TableReader(place, table, faults, keys_of(name))


def inner(reader: TableReader, name: str, schema: str = "") -> TableReader:
    """Return the reader of a table within another one; an absent one is empty.

    Parameters
    ----------
    schema : its dotted name in the schema; "": that of the table, and its own.
    """
    place, table = f"{reader.place}: {legible(name)}", reader.raw(name, {})
    name = f"{reader.loc}.{name}".lstrip(".")
    return reader_of(schema or name, place, table, reader.faults)


def tables_in(reader: TableReader, name: str, *, needed: bool = False) -> list[TableReader]:
    """Return the readers of a list of tables within a table; none, and a fault, of others."""
    tables, whole_name = reader.raw(name, []), f"{reader.loc}.{name}".lstrip(".")
    if not isinstance(tables, list) or (needed and not tables):
        reader.wrong(name, f"must be tables, [[{whole_name}]]")
        return []
    return [
        reader_of(whole_name, f"{reader.place}: {name} {number}", table, reader.faults)
        for number, table in enumerate(tables, start=1)
    ]


def read_all(reader: TableReader) -> list[Any]:
    """Return the values of a table in its keys' order, and refuse all other keys."""
    values = [reader.read(key) for key in keys_of(reader.loc)]
    reader.finish()
    return values


def refuse(reader: TableReader, where: str, *names: str) -> None:
    """Refuse keys that must be absent where a table has others, as ``where`` says."""
    for name in names:
        if name in reader:
            reader.raw(name)
            reader.wrong(name, f"must be absent {where}", "conflict")


def check_start(reader: TableReader, start: float, bounds: tuple[float, float]) -> None:
    """Refuse a start beyond its bounds, which are told as they are written."""
    if not bounds[0] <= start <= bounds[1]:
        written = toml_value(reader.raw("bounds", bounds))
        reader.wrong("start", f"must be within its bounds, {written}")
