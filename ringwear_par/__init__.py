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
a result or drawing it starts MPI, PETSc or compiled code.
"""

from importlib import import_module
from typing import Any

from ringwear_par.version import __version__ as __version__

#: module of each name; their types are in __init__.pyi
_PUBLIC = {
    "Case": "cases.case",
    "ComputationError": "errors",
    "ContactPair": "elasticity.bem.pair",
    "DesignResult": "identification.test_design.design",
    "FailedResult": "results.result",
    "FitResult": "identification.fit_result",
    "Function": "functions.function",
    "InputError": "errors",
    "LocalState": "wear.local_state",
    "MeasureResult": "measuring.measure_result",
    "Prediction": "prediction.prediction",
    "Result": "results.result",
    "Study": "studies.definition.study",
    "WearLaw": "wear.law",
    "assemble": "history.elastic.pairs",
    "design": "identification.test_design.design",
    "fit": "identification.fit",
    "function": "functions.function",
    "measure": "measuring.measure",
    "open_ensemble": "studies.storage.ensemble",
    "open_result": "results.storage.result_files",
    "plot": "studies.pictures.plot",
    "predict": "prediction.predict",
    "read_case": "cases.files.reading",
    "read_study": "studies.definition.study",
    "report": "reports.report",
    "save": "results.result",
    "simulate": "results.execution.simulate",
    "simulate_all": "studies.execution.many",
    "summary": "results.result",
    "surrogate": "studies.analysis.surrogate",
    "sweep": "studies.execution.sweep",
    "to_dict": "results.result",
}
__all__ = [*_PUBLIC]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
