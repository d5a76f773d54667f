"""The keys of a study: one list that reading, messages and ``info --schema study`` follow."""

from ringwear_par.cases.tables import Key, keys_of_table
from ringwear_par.cases.values import anything, one_of, text, whole

METHODS = ("grid", "sobol", "latin-hypercube", "random", "list")
#: most cases of a design
MOST_CASES = 10**7
_RANGE = anything("two increasing numbers, > 0 for log")

KEYS: tuple[Key, ...] = (
    Key("case", *text("the name of a case file, relative to this one; in Python a dict too"), "-",
        "base case, whose keys [vary] changes"),
    Key("vary.KEY.values", *anything("a list of values"), "KEY's",
        "list of values of a case key, or of an entry of a key, such as upper.r[1], "
        "upper.profile.crown, lower.layers[0].wear.k; each key has values, linear or log", None),
    Key("vary.KEY.linear", *_RANGE, "KEY's",
        "range [low, high], in equal steps (grid) or sampled uniformly", None),
    Key("vary.KEY.log", *_RANGE, "KEY's",
        "range [low, high], in equal ratios (grid) or sampled uniformly in the logarithm", None),
    Key("vary.KEY.count", *whole(2, MOST_CASES), "-",
        "number of values of a linear or log range (method = grid)", None),
    Key("design.method", *one_of(*METHODS), "-",
        "grid: all combinations; sobol, latin-hypercube, random: count samples; list: the rows of "
        "file, without [vary]", "grid"),
    Key("design.count", *whole(1, MOST_CASES), "-",
        "number of cases (method = sobol, latin-hypercube or random)", None),
    Key("design.seed", *whole(0, 10**18), "-",
        "seed of the random samples: the same seed gives the same cases", 0),
    Key("design.file", *text("the name of a CSV file, relative to this one"), "-",
        "table of cases: a line of case keys, then one line a case (method = list)", None),
)  # fmt: skip
DESIGN = keys_of_table(KEYS, "design")
