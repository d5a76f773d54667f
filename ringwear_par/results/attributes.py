"""Attributes of a result: its case, laws, densities and sliding."""

import json
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.files.law_trials import law_sources
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.results.variables import TIMES_THROUGH
from ringwear_par.schedules import Table, in_time, mean, points_of
from ringwear_par.version import versions


def case_attributes(case: Case, time: float) -> dict[str, Any]:
    """Return the attributes of a case whose history has come to a time (s). Not collective."""
    density: dict[str, Any] = {}
    for body, ring in zip(BODIES, case.rings, strict=True):  # g/mm3, or NaN
        if ring.density is not None:
            density[f"density_{body}"] = ring.density
        layers = [layer.density for layer in ring.layers]
        if any(value is not None for value in layers):
            values = (np.nan if value is None else value for value in layers)
            density[f"density_{body}_layers"] = tuple(values)
    return {
        "case": case.stored_text,
        "title": case.title,
        **versions(),
        "scheme": case.time.scheme,
        "time_step": case.time.step,
        "time_steps": case.time.steps,
        "time_end": case.time.end,
        "friction": mean(case.friction, 0.0, time or case.time.end),  # so far
        # as texts: other attributes of HDF5 have room for 64 kB
        **{
            f"{name}_table": json.dumps(points_of(table))
            for name, table in (("friction", case.friction), ("omega", case.load.omega))
            if isinstance(table, Table)
        },
        "nominal_area": case.area,  # mm2
        "mean_radius": case.mean_radius,  # mm
        "omega": in_time(case.load.omega, time),  # rad/s
        **density,
        **{
            f"face_{body}": section.face_description
            for body, section in zip(BODIES, case.sections, strict=True)
            if section.face
        },
        "user_laws": json.dumps(law_sources(case)),
        **{
            f"law_{body}": "" if law is None else law.describe()
            for body, law in zip(BODIES, case.laws, strict=True)
        },
        # whether worn volume is a constant times the friction energy, by layer, of a body
        "energy_identity": int(
            any(all(law.ratios(case.friction)) for law in case.laws if law is not None)
        ),
    }


def times_through(case: Case, through: FloatArray) -> dict[str, FloatArray]:
    """Return when wear first got through the layers of each body that has some, s or NaN.

    Parameters
    ----------
    through : (2, ...) s, see ``State``.
    """
    return {
        name: np.where(np.isfinite(time), time, np.nan)
        for name, time, ring in zip(TIMES_THROUGH, through, case.rings, strict=True)
        if ring.layers
    }
