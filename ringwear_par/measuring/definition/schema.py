"""The keys of a measure file: reading, messages and ``info --schema measure`` follow them."""

from ringwear_par.cases.tables import Key, file_keys, keys_of_table
from ringwear_par.cases.values import anything, number, one_of, text
from ringwear_par.measuring.definition.problem import Limits

#: inputs that may have an uncertainty, with their units; of some only a relative one has a meaning
UNCERTAIN = {
    "load.force": "N", "load.pressure": "MPa", "load.omega": "rad/s", "lower.density": "g/mm^3",
    "upper.density": "g/mm^3", "torque": "N mm", "displacement": "", "time": "",
}  # fmt: skip
_USUAL = Limits()
_CHANNELS = anything("texts for time, wear, torque, load and temperature")

KEYS: tuple[Key, ...] = (
    Key("case", *text("the name of a case file, relative to this one; in Python a dict too"), "-",
        "case of the rig: rings, load, speed, densities, and a table [wear.lower] or [wear.upper] "
        "for the body that wears (its wear law is not used)"),
    Key("measure.masses.file", *text("the name of a table of weighings"), "-",
        "table of weighings, relative to this file: a row for each specimen, with the name of its "
        "test; columns of masses before (vor, initial) and after (nach, final), repeated ones "
        "averaged, or of the loss", None),
    Key("measure.masses.sd", *number(0.0), "g",
        "standard uncertainty of one weighing, with its unit (\"0.1 mg\"), a loss being of two; "
        "default: the scatter of "
        "repeated weighings, at least that of their last digit", None),
    *(Key(f"measure.uncertainty.{name}",
          *anything("a number > 0, or { relative = x }" if unit else "{ relative = x }, x > 0"),
          unit or "1", f"standard uncertainty of {meaning}", None)
      for (name, unit), meaning in zip(UNCERTAIN.items(), (
          "the load", "the mean pressure, instead of load.force", "the speed",
          "the density of the lower body",
          "the density of the upper body", "the torque", "the scale of the displacement",
          "the rate of the clock",
      ), strict=True)),
    Key("measure.steady.wear", *number(0.0, 1.0), "1",
        "largest change of the wear rate within the steady part, as a share of the rate",
        _USUAL.wear),
    Key("measure.steady.friction", *number(0.0, 1.0), "1",
        "largest change of the friction coefficient within the steady part, as a share of it",
        _USUAL.friction),
    Key("measure.steady.from", *number(0.0, ends=True), "s",
        "start of the steady part of all tests; default: found in each record", None),
    Key("test.name", *text("a text, its name"), "-",
        "name of the specimen, as in the table of weighings"),
    Key("test.file", *text("the name of a table: a text file with commas, semicolons or tabs"), "-",
        "record of the test, relative to this file: a line of column names, perhaps a row of "
        "units, then numbers; as experiment.data.file of fit files"),
    Key("test.columns", *_CHANNELS, "-",
        "names of the columns of file; default: usual names, such as t, time, Zeit, "
        "timestamp, Datum/Uhrzeit; wear, depth, z, displacement, penetration, Weg, position, "
        "Verschlei\N{LATIN SMALL LETTER SHARP S}; torque, M, Reibmoment; load, F, Last; T, "
        "temperature", None),
    Key("test.units", *_CHANNELS, "-",
        "units of the columns of file, as pint writes them; default: the units in the columns' "
        "names or in the row below them. A column without a unit is refused", None),
    *file_keys("test"),
    Key("test.exclude", *anything("a list of increasing pairs"), "s",
        "pairs of times between which readings are left out; they do not shorten the test", None),
    Key("test.sense", *one_of("rising", "falling"), "-",
        "direction of the displacement while material is lost; default: falling for a record that "
        "ends lower than it starts, else rising",
        None),
    Key("test.set", *anything("a table of case keys and their values"), "-",
        "case keys that differ in this test; time.end is the sliding time, by default from the "
        "first reading to the last", None),
)  # fmt: skip
MEASURE, MASSES, UNCERTAINTY, STEADY, TEST = (
    keys_of_table(KEYS, table)
    for table in ("measure", "measure.masses", "measure.uncertainty", "measure.steady", "test")
)
