"""A wear law from a user's Python file."""

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Self

from ringwear_par.errors import InputError
from ringwear_par.files.text import read_text
from ringwear_par.schedules import Quantity, breakpoints
from ringwear_par.schedules import stack as stack_quantities
from ringwear_par.wear.checked_law import PARAMETERS, CheckedLaw, UserFunction
from ringwear_par.wear.law import Parameter


@lru_cache(maxsize=64)
def _compiled(source: str, name: str) -> dict[str, Any]:
    """Return the names that the source of a user's law defines. On every rank, once."""
    names: dict[str, Any] = {"__name__": "user_law", "__file__": name}
    exec(compile(source, name, "exec"), names)
    return names


@lru_cache(maxsize=64)
def _reads_wear(source: str) -> bool:
    """Tell whether Python source has an attribute ``wear``, as in ``at.wear``."""
    nodes = ast.walk(ast.parse(source))
    return any(isinstance(node, ast.Attribute) and node.attr == "wear" for node in nodes)


@dataclass(frozen=True)
class UserLaw(CheckedLaw):
    """A law of your own, from a Python file.

    The file defines ``rate(p, at)``, the rate of depth in mm/s at pressures p in MPa; ``at`` knows
    the speed, the radius, the friction coefficient, the time, the depth worn off and the distance
    slid so far, and the numbers that the case gives in ``parameters``, in whatever units the file
    has them.

    Use it for what the other laws cannot say: rounded thresholds, levelling off at high pressures,
    coefficients that follow the temperature of a record. Studies and fits vary its parameters as
    those of the others.

    The rate must be 0 without pressure, continuous, not negative, and must not fall with the
    pressure. It is called for one history at a time, which makes large sweeps slower. Whatever the
    file does wrong is told with time and element.

    The file may define ``d_rate_dp(p, at)`` and ``d_rate_dwear(p, at)``, and a list ``breakpoints``
    of times (s) at which the rate jumps or bends, where adaptive steps end. A file that reads
    ``at.wear`` remembers worn depth, exactly, unless it says ``remembers = False``.
    """

    name = "user"
    one_by_one = True
    formula = "rate(p, at) of a Python file"

    #: its name
    file: Annotated[
        str,
        Parameter(
            "-",
            "file, relative to the case file, that defines rate(p, at), as user_law.py does",
            "file",
        ),
    ]
    #: its text
    source: str
    #: pairs of name and quantity, which ``at.parameters`` holds at the time
    parameters: Annotated[
        tuple[tuple[str, Quantity], ...],
        Parameter(
            "-", "parameters of the law, which rate(p, at) reads from at.parameters", "parameters"
        ),
    ] = ()

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> Self:
        """Return the law that a file defines.

        Raises
        ------
        InputError : the file cannot be read or run, or does not define a law.
        """
        path = Path(values["file"])
        try:
            law = cls(str(path), read_text(path), values["parameters"] or ())
        except InputError as error:
            raise InputError(f"file = {error}; must be a Python file") from error
        missing = law.missing()
        if missing:
            raise InputError(f"file = {path}: {missing}")
        return law

    def missing(self) -> str:
        """Return the fault that keeps the file from being a law, "" if there is none."""
        try:
            names = self._functions
        except (Exception, SystemExit) as error:  # whatever a user's code may raise
            return f"cannot be run ({type(error).__name__}: {error}); must be a Python file"
        if not callable(names.get("rate")):
            return "does not define rate; must define rate(p, at)"
        return ""

    @property
    def called(self) -> str:
        """Name of the law in messages."""
        return self.file

    def defined(self, function: UserFunction) -> Callable[..., Any] | None:
        """Return a function of the file; None where it has none."""
        return self._functions.get(function)

    @property
    def remembers(self) -> bool:
        """Whether the rate depends on worn depth."""
        if "remembers" in self._functions:
            return bool(self._functions["remembers"])
        return "d_rate_dwear" in self._functions or _reads_wear(self.source)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which a parameter's table bends, and those that the file names."""
        times = {float(time) for time in self._functions.get("breakpoints", ())}
        return tuple(sorted(times.union(breakpoints(*(q for _, q in self.parameters)))))

    @property
    def numeric(self) -> tuple[str, ...]:
        """Names of the parameters: "parameters.k"."""
        return tuple(PARAMETERS + name for name, _ in self.parameters)

    def quantity(self, name: str) -> Quantity:
        """Return a numeric parameter as it was given."""
        return dict(self.parameters)[name.removeprefix(PARAMETERS)]

    def describe(self) -> str:
        """Return the file's name with its parameters."""
        return f"rate(p, at) of {self.file}" + self._values_text(dict(self.parameters))

    @property
    def _functions(self) -> dict[str, Any]:
        return _compiled(self.source, self.file)

    @classmethod
    def stacked(cls, laws: Sequence[Self]) -> Self:
        """Return one law for some histories whose laws differ in parameters only.

        Raises
        ------
        ValueError : they are of different files, or have other parameters.
        """
        first = laws[0]
        kinds = {(law.file, law.source, tuple(name for name, _ in law.parameters)) for law in laws}
        if len(kinds) > 1:
            raise ValueError("laws of different Python files or parameters cannot be stacked")
        columns = zip(*(law.parameters for law in laws), strict=True)
        stacks = ((pairs[0][0], stack_quantities([q for _, q in pairs])) for pairs in columns)
        return replace(first, parameters=tuple(stacks))

    def _with_stacks(self, change: Callable[[Any], Any]) -> Self:
        return replace(self, parameters=tuple((name, change(q)) for name, q in self.parameters))
