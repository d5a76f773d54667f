"""Wear histories of ring-on-ring and ring-on-disc tests by boundary elements, on MPI and PETSc.

Rooms follow the paper (Serre, Bonnet and Pradeilles-Duval 2001): ``elasticity`` eq. (5),
``contact`` (3), ``wear`` (4), ``history`` section 3; around them ``cases``, ``results``,
``studies``, ``identification``, ``prediction``, ``measuring``, ``functions``, ``reports`` and
``explorer``.
Units: mm, N, MPa, s, rad; energies N mm.

    import ringwear_par as rw

    case = rw.read_case("paper.toml", {"load.pressure": 50})
    result = rw.simulate(case)
    data = result.to_xarray()

The names below are loaded when they are first used; neither the import nor reading a case, opening
a result or drawing it starts MPI and PETSc.
"""

import re
from importlib import import_module
from pathlib import Path
from typing import Any

from ringwear_par.version import __version__ as __version__

#: module of each name, as __init__.pyi has them with their types
_PUBLIC = {
    name: module
    for module, name in re.findall(
        r"^from (\S+) import (\w+) as \w+$", Path(__file__).with_suffix(".pyi").read_text(), re.M
    )
    if name != "__version__"
}
__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
