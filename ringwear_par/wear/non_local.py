"""The paper's law of an averaged pressure."""

from dataclasses import dataclass, field
from typing import Annotated

from ringwear_par.wear.parameters import Parameter
from ringwear_par.wear.threshold import ThresholdLaw


@dataclass(frozen=True)
class NonLocalLaw(ThresholdLaw):
    """``k mu max(0, <p> - p0) V``, pressure and the wear that it causes averaged over a length.

    The same average, which keeps constants and volumes, is taken of the pressure and of the rate:
    pressure felt at a distance wears at that distance. Taken of the pressure only, the step
    would no longer be a minimisation, nor its solution be sure to exist. ``rate`` is that of a
    pressure already averaged; ``WearIncrement`` takes the averages.
    """

    name = "non-local"
    formula = "<k mu max(0, <p> - p0) V>, averaged over length,"

    length: Annotated[
        float,
        Parameter(
            "mm",
            "standard deviation of the Gaussian average of the pressure, and of the wear that it "
            "causes",
            "number",
            ends=False,
            local=False,
        ),
    ] = field(kw_only=True)

    def _per_energy(self, friction: float) -> float | None:
        """Return None: the sliding speed is not averaged."""
        return None
