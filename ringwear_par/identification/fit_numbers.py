"""The numbers of a fit as people read them: rows that its summary and its page share.

All functions take the contents of fit.json (``FitResult.to_dict``).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

Outcome = Mapping[str, Any]

#: units of nuisances, after that of their readings
_PER = {"compliance": "/kN", "tilt": "/mm"}


@dataclass(frozen=True)
class SeriesRow:
    """A series of readings and its misfit; ``noise`` is None unless it was fitted."""

    experiment: str
    name: str
    n: int
    chi2: float
    unit: str
    noise: float | None
    nuisances: str


@dataclass(frozen=True)
class LawRow:
    """A law that was compared; numbers are None where its fit failed."""

    name: str
    aic_difference: float | None
    bic: float | None
    chi2: float | None
    parameters: str
    verdict: str


def counted(number: int, noun: str) -> str:
    """Return a number with its noun."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def unit_suffix(unit: str) -> str:
    """Return a unit with a blank before it; "" for none."""
    return "" if unit in ("1", "-") else f" {unit}"


def value_text(estimate: Mapping[str, Any]) -> str:
    """Return an estimate with its standard deviation, where it is identified, and its unit."""
    sd = estimate["sd"] if estimate["verdict"] == "identified" else None
    return f"{_with_sd(estimate['estimate'], sd, 5)}{unit_suffix(estimate['unit'])}"


def goodness(outcome: Outcome) -> str:
    """Return chi2, degrees of freedom, p-value and information criteria in a sentence."""
    p_value = outcome["p_value"]
    noise_fitted = any(row.noise is not None for row in series_rows(outcome))
    if p_value is not None:
        test = f"p = {p_value:.2g}" + " of those whose noise is given" * noise_fitted
    elif noise_fitted:
        test = "all noise was fitted"
    else:
        test = 'loss "student"' if outcome["loss"] == "student" else "no p-value"
    return (
        f"chi2 = {outcome['chi2']:.5g} of {outcome['n_data']} readings, "
        f"{outcome['degrees_of_freedom']} degrees of freedom ({test}); "
        f"AIC {outcome['aic']:.5g}, BIC {outcome['bic']:.5g}"
    )


def series_rows(outcome: Outcome) -> Iterator[SeriesRow]:
    """Yield the series of all experiments, with their nuisances."""
    for experiment, series in outcome["experiments"].items():
        fitted = outcome["nuisance"].get(experiment, {})
        for name, entry in series.items():
            unit = entry["unit"]
            nuisances = ", ".join(
                f"{kind} not identified"
                if nuisance["sd"] is None
                else f"{kind} {_with_sd(nuisance['estimate'], nuisance['sd'], 3)} {unit}"
                f"{_PER.get(kind, '')}"
                for kind, nuisance in fitted.get(name, {}).items()
            )
            yield SeriesRow(
                experiment, name, entry["n"], entry["chi2"], unit, entry.get("sd"), nuisances
            )


def law_rows(outcome: Outcome) -> list[LawRow]:
    """Return the laws that were compared, the best by AIC first, those that failed last."""
    laws = {"this law": outcome, **outcome["alternatives"]}
    solved = {name: law for name, law in laws.items() if "aic" in law}
    best = min(law["aic"] for law in solved.values())
    rows = []
    for name, law in sorted(solved.items(), key=lambda item: item[1]["aic"]):
        parameters = ", ".join(f"{key} = {value_text(p)}" for key, p in law["parameters"].items())
        verdict = "does not fit" if law["flagged"] else "fits"
        if law["p_value"] is None:
            verdict = "not tested: noise was fitted, or has long tails"
        rows.append(LawRow(name, law["aic"] - best, law["bic"], law["chi2"], parameters, verdict))
    rows += [
        LawRow(name, None, None, None, "", f"failed: {law['error']}")
        for name, law in laws.items()
        if name not in solved
    ]
    return rows


def _with_sd(value: float, sd: float | None, digits: int) -> str:
    return f"{value:.{digits}g}" + ("" if sd is None else f" +- {sd:.2g}")
