"""The keys of a study: one list that reading, messages and ``info --schema study`` follow."""

from ringwear_par.cases.tables import Key, keys_of_table
from ringwear_par.cases.values import anything, one_of, text, whole

METHODS = ("grid", "sobol", "latin-hypercube", "random", "list")
#: of a design
MOST_CASES = 10**7
_RANGE = anything("two increasing numbers, > 0 of log")

KEYS: tuple[Key, ...] = (
    Key("case", *text("the name of a case file, relative to this one; in Python a dict too"), "-",
        "the base case: what does not vary"),
    Key("vary.KEY.values", *anything("a list of values"), "KEY's",
        "values of a case key, or of an entry of one: upper.r[1], upper.profile.crown, "
        "lower.layers[0].wear.k; a key has values, linear or log", None),
    Key("vary.KEY.linear", *_RANGE, "KEY's", "[low, high]: equal steps, or uniform samples", None),
    Key("vary.KEY.log", *_RANGE, "KEY's", "[low, high]: the same of the logarithm", None),
    Key("vary.KEY.count", *whole(2, MOST_CASES), "-",
        "number of values of a range in a grid (method = grid)", None),
    Key("design.method", *one_of(*METHODS), "-",
        "grid: all combinations; sobol, latin-hypercube, random: count samples; list: the rows of "
        "file, without [vary]", "grid"),
    Key("design.count", *whole(1, MOST_CASES), "-",
        "number of cases (method = sobol, latin-hypercube or random)", None),
    Key("design.seed", *whole(0, 10**18), "-", "of the samples, which it determines", 0),
    Key("design.file", *text("the name of a CSV file, relative to this one"), "-",
        "a line of case keys, and one line a case (method = list)", None),
)  # fmt: skip
DESIGN = keys_of_table(KEYS, "design")
