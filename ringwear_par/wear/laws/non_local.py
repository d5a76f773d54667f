"""The paper's law of an averaged pressure.

The same average is taken of the pressure and of the rate: pressure felt at a distance wears at
that distance. Taken of the pressure only, a step would no longer be a minimisation, nor its
solution be sure to exist. ``rate`` is that of a pressure already averaged; ``WearIncrement`` takes
the averages.
"""

from dataclasses import dataclass, field
from typing import Annotated

from ringwear_par.wear.laws.threshold import ThresholdLaw
from ringwear_par.wear.parameters import Parameter


@dataclass(frozen=True)
class NonLocalLaw(ThresholdLaw):
    """The threshold law of a pressure that is averaged over a length.

    The threshold law, k in 1/MPa and p0 in MPa, with the pressure averaged by a Gaussian of the
    standard deviation ``length`` (mm) along the radius. The wear is averaged in the same way, which
    does not change the worn volume.

    Use it where peaks of pressure narrower than a grain, a particle or the spacing of asperities
    should not wear by themselves. At a sharp edge the elastic pressure is infinite. With the other
    laws, the wear rate there depends on the size of the elements; with this law, on ``length``.

    Speed and friction are not averaged. Profiles cannot bend within ``length``, so grooves and
    steps narrower than ``length`` are smoothed too. Fit ``length`` to profiles near edges.
    """

    name = "non-local"
    formula = "<k mu max(0, <p> - p0) V> (<> averages over length)"

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

    def per_energy(self, friction: float) -> float | None:
        """Return None: the sliding speed is not averaged."""
        return None
