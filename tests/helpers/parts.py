"""Parts of the package that tests of other rooms use: where they are is written here only.

Tests of a room import that room, ``ringwear_par`` and helpers: what moves is changed here once.
"""

from importlib import import_module

from wearing import ArchardLaw as ArchardLaw
from wearing import NonLocalLaw as NonLocalLaw
from wearing import PowerLaw as PowerLaw
from wearing import RunningInLaw as RunningInLaw
from wearing import ThresholdLaw as ThresholdLaw

#: names by the module that they are in
PLACES = {
    "cases.case": "Load Output Ring RingLayer Stepping",
    "cases.files.law_trials": "refuse_bad_laws",
    "cases.files.reading": "parse_case",
    "cases.files.weighings": "read_weighings",
    "cases.units": "factor named_unit unit_of_column",
    "cases.values": "RejectedError",
    "cli": "main",
    "batched": "take",
    "contact.block": "BlockSolver",
    "contact.problem": "Compliance Line",
    "contact.tao": "TaoContact",
    "elasticity.bem.body": "compliance",
    "elasticity.bem.boundary": "node_wear",
    "elasticity.bem.pair": "UpdatedGeometry",
    "elasticity.mesh": "Mesh case_slopes common_slope",
    "elasticity.sections": "Material",
    "elasticity.stress.fields": "COMPONENTS SIDES max_shear mises principal",
    "errors": "legible",
    "files.measurements": "read_measurements",
    "files.smoothing": "curve penalised",
    "files.spreadsheets": "write_xlsx",
    "files.text": "parse_toml toml_text",
    "history.elastic": "bodies boundary_recovery operator_key",
    "history.loop": "first_contact simulate_one",
    "identification.definition.fit_file": "read_fit",
    "identification.definition.problem": "FittedParameter ProcessNoise Scatter Series",
    "identification.draws": "Draws conditions_of law_names read_draws write_draws",
    "identification.histories": "Readings",
    "identification.likelihood": "TestLikelihood",
    "identification.noise": "Setting",
    "identification.solution": "solve",
    "measuring.definition.measure_file": "read_measure",
    "pictures.figures": "FigureFile plot",
    "pictures.run_panels": "HISTORY_PANELS",
    "prediction.predict": "draw_paces fit_draws",
    "prediction.prediction": "TimeTo",
    "reports.spreadsheets": "export",
    "results.files": "atomic_hdf5",
    "results.run": "run_case",
    "results.progress": "StopSignals",
    "results.key_numbers": "key_numbers",
    "results.variables": "HISTORIES edge_elements",
    "schedules": "Table bends in_time integral",
    "reports.plot": "draw_sweep plot_stored",
    "studies.many": "computed results_of",
    "studies.pictures": "choose",
    "studies.sweep": "run_sweep",
    "cases.law": "Law NO_WEAR in_words",
    "wear.laws": "LAWS threshold",
    "wear.user": "user",
}
_MODULES = {name: module for module, names in PLACES.items() for name in names.split()}


def __getattr__(name):
    """Return a part when it is imported from here."""
    if name not in _MODULES:
        raise AttributeError(name)
    return getattr(import_module(f"ringwear_par.{_MODULES[name]}"), name)
