"""The keys of a measure file: reading, messages and ``info --schema measure`` follow them."""

from ringwear_par.cases.tables import Key, keys_of_table
from ringwear_par.cases.values import anything, number, one_of, text
from ringwear_par.measuring.definition.problem import Limits

#: inputs whose uncertainty may be told, with their units; of some only a share means something
UNCERTAIN = {
    "load.force": "N", "load.pressure": "MPa", "load.omega": "rad/s", "lower.density": "g/mm^3",
    "upper.density": "g/mm^3", "torque": "N mm", "displacement": "", "time": "",
}  # fmt: skip
_USUAL = Limits()
_CHANNELS = anything("texts for time, wear, torque, load and temperature")

KEYS: tuple[Key, ...] = (
    Key("case", *text("the name of a case file, relative to this one; in Python a dict too"), "-",
        "the rig: rings, load, speed, densities and which body has a table of wear; its wear laws "
        "are not used"),
    Key("measure.masses.file", *text("the name of a table of weighings"), "-",
        "relative to this file: a row a specimen, named as its test; masses before (vor, initial) "
        "and after (nach, final), several of which are averaged, or the loss", None),
    Key("measure.masses.sd", *number(0.0), "g",
        "standard uncertainty of one weighing, two of which a loss is of; default: the scatter of "
        "masses read several times, at least that of their last digit", None),
    *(Key(f"measure.uncertainty.{name}",
          *anything("a number > 0, or { relative = x }" if unit else "{ relative = x }, x > 0"),
          unit or "1", f"standard uncertainty of {meaning}", None)
      for (name, unit), meaning in zip(UNCERTAIN.items(), (
          "the load", "the pressure, instead", "the speed", "the density of lower",
          "the density of upper", "the torque", "the displacement, its scale",
          "the clock, its rate",
      ), strict=True)),
    Key("measure.steady.wear", *number(0.0, 1.0), "1",
        "share of the wear rate that it may change by in the steady part", _USUAL.wear),
    Key("measure.steady.friction", *number(0.0, 1.0), "1", "the same of friction",
        _USUAL.friction),
    Key("measure.steady.from", *number(0.0, ends=True), "s",
        "start of the steady part of all tests, where it is not to be looked for", None),
    Key("test.name", *text("a text, its name"), "-", "of the specimen, as among the weighings"),
    Key("test.file", *text("the name of a table: a text file with commas, semicolons or tabs"), "-",
        "the record, relative to this file: a line of column names, perhaps a row of their units, "
        "then numbers; see experiment.data.file of fit files"),
    Key("test.columns", *_CHANNELS, "-",
        "names of its columns; default: those whose names tell it, such as t, time, Zeit, "
        "timestamp, Datum/Uhrzeit; wear, depth, z, displacement, penetration, Weg, position, "
        "Verschlei\N{LATIN SMALL LETTER SHARP S}; torque, M, Reibmoment; load, F, Last; T, "
        "temperature", None),
    Key("test.units", *_CHANNELS, "-",
        "units of its columns, as pint knows them; default: those in the columns' names or in the "
        "row below; without one a column is refused", None),
    Key("test.exclude", *anything("a list of increasing pairs"), "s",
        "readings left out, from time to time; the test is as long with them", None),
    Key("test.sense", *one_of("rising", "falling"), "-",
        "of the displacement while material is lost; default: falling where it falls in total",
        None),
    Key("test.set", *anything("a table of case keys and their values"), "-",
        "case keys of this test; time.end is how long it slid, by default the last stamp less the "
        "first", None),
)  # fmt: skip
MEASURE, MASSES, UNCERTAINTY, STEADY, TEST = (
    keys_of_table(KEYS, table)
    for table in ("measure", "measure.masses", "measure.uncertainty", "measure.steady", "test")
)
