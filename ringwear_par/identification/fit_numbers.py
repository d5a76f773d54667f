"""The contents of fit.json."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.identification.doubts import checks

if TYPE_CHECKING:
    from ringwear_par.identification.fit_result import FitResult


def to_dict(fit: "FitResult") -> dict[str, Any]:
    """Return the contents of fit.json."""
    problem, solution = fit.problem, fit.solution
    return {
        "parameters": {key: dict(entry) for key, entry in fit.entries.items()},
        "keys": [*problem.keys],
        "covariance": fit.covariance.tolist(),
        "level": problem.settings.level,
        "chi2": fit.chi2,
        "n_data": fit.n,
        "degrees_of_freedom": fit.freedom,
        "p_value": fit.p_value,
        "flagged": fit.flagged,
        "aic": fit.aic,
        "evidence": solution.log_evidence,
        "evidence_error": solution.evidence_error,
        "specimens": len({test.groups[0] for test in problem.experiments}),
        "process": {key: dict(entry) for key, entry in fit.process.items()},
        "experiments": fit.experiments,
        "nuisance": fit.nuisances,
        "inputs": _inputs(fit),
        "histories": solution.histories,
        "failed_histories": solution.failed,
        "steps": solution.steps,
        "draws": {"effective": solution.effective, "stored": len(fit.draws)},
        "checks": checks(fit),
        "doubts": [doubt.to_dict() for doubt in fit.doubts],
        "warnings": [doubt.text for doubt in fit.doubts],
        "alternatives": {
            name: {
                k: v
                for k, v in alternative.to_dict().items()
                if k not in ("alternatives", "data")
            }
            for name, alternative in fit.alternatives.items()
        }
        | {name: {"error": reason} for name, reason in fit.failed.items()},
        "loss": problem.settings.loss,
        "versions": dict(fit.versions),
        "data": dict(problem.hashes),
    }  # fmt: skip


def _inputs(fit: "FitResult") -> dict[str, dict[str, Any]]:
    """Return curve, scatter of the readings about it, and scale of each input, by test and key.

    The curve is at ``time``, s; the scatter is a relative standard deviation.
    """
    inputs: dict[str, Any] = {}
    for test in fit.tests:
        number, case = 0, test.experiment.case
        for measured in test.experiment.inputs:
            curve, readings = measured.curve(case), measured.readings(case)
            off = readings / np.maximum(curve(measured.series.x), np.finfo(float).tiny) - 1.0
            entry: dict[str, Any] = {
                "time": list(curve.x), "value": list(curve.y), "unit": measured.unit,
                "n": measured.series.n, "scatter": float(np.sqrt(np.mean(off**2))),
            }  # fmt: skip
            if measured.scale is not None:
                (mean, sd), drawn = measured.scale, test.nuisances[-1, str(number)]
                number += 1
                entry["scale"] = {"estimate": mean + sd * float(drawn.mean()),
                                  "sd": sd * float(drawn.std())}  # fmt: skip
            inputs.setdefault(test.experiment.name, {})[measured.key] = entry
    return inputs
