"""Wear histories of ring-on-ring and ring-on-disc tests by boundary elements, on MPI and PETSc.

Rooms follow the paper (Serre, Bonnet and Pradeilles-Duval 2001): ``elasticity`` eq. (5),
``contact`` (3), ``wear`` (4), ``history`` section 3; around them ``cases``, ``results``,
``studies``, ``identification``, ``reports``, ``explorer`` and ``verification``. Units: mm, N, MPa,
s, rad; energies N mm.

    import ringwear_par as rw

    case = rw.read_case("paper.toml", {"load.pressure": 50})
    result = rw.simulate(case)
    data = result.to_xarray()

The names below are loaded when they are first used; neither the import nor reading a case, opening
a result or drawing it starts MPI, PETSc or compiled code.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ringwear_par.version import __version__ as __version__

if TYPE_CHECKING:
    from ringwear_par.cases.case import Case
    from ringwear_par.cases.files.reading import read_case
    from ringwear_par.elasticity.bem.pair import ContactPair
    from ringwear_par.errors import ComputationError, InputError
    from ringwear_par.history.elastic.pairs import assemble
    from ringwear_par.identification.fit import fit
    from ringwear_par.identification.fit_result import FitResult
    from ringwear_par.identification.test_design.design import DesignResult, design
    from ringwear_par.outcomes import save, summary, to_dict
    from ringwear_par.reports.report import report
    from ringwear_par.results.execution.simulate import simulate
    from ringwear_par.results.result import FailedResult, Result
    from ringwear_par.results.storage.result_files import open_result
    from ringwear_par.studies.analysis.surrogate import surrogate
    from ringwear_par.studies.definition.study import Study, read_study
    from ringwear_par.studies.execution.many import simulate_all
    from ringwear_par.studies.execution.sweep import sweep
    from ringwear_par.studies.pictures.figures import plot
    from ringwear_par.studies.storage.ensemble import open_ensemble
    from ringwear_par.wear.law import WearLaw
    from ringwear_par.wear.local_state import LocalState

_PUBLIC = {
    "Case": "cases.case",
    "ComputationError": "errors",
    "ContactPair": "elasticity.bem.pair",
    "DesignResult": "identification.test_design.design",
    "FailedResult": "results.result",
    "FitResult": "identification.fit_result",
    "InputError": "errors",
    "LocalState": "wear.local_state",
    "Result": "results.result",
    "Study": "studies.definition.study",
    "WearLaw": "wear.law",
    "assemble": "history.elastic.pairs",
    "design": "identification.test_design.design",
    "fit": "identification.fit",
    "open_ensemble": "studies.storage.ensemble",
    "open_result": "results.storage.result_files",
    "plot": "studies.pictures.figures",
    "read_case": "cases.files.reading",
    "read_study": "studies.definition.study",
    "report": "reports.report",
    "save": "outcomes",
    "simulate": "results.execution.simulate",
    "simulate_all": "studies.execution.many",
    "summary": "outcomes",
    "surrogate": "studies.analysis.surrogate",
    "sweep": "studies.execution.sweep",
    "to_dict": "outcomes",
}
__all__ = [
    "Case", "ComputationError", "ContactPair", "DesignResult", "FailedResult", "FitResult",
    "InputError", "LocalState", "Result", "Study", "WearLaw", "assemble", "design", "fit",
    "open_ensemble", "open_result", "plot", "read_case", "read_study", "report", "save", "simulate",
    "simulate_all", "summary", "surrogate", "sweep", "to_dict",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
