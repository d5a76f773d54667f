"""Does it matter that elasticity stays that of the unworn coating? Fixed and updated, in a table.

    python scripts/follow_through_coatings.py [THICKNESS,MODULUS ...]

``wear_through.toml`` with coatings of several thicknesses (um) and moduli (GPa), whose wear
coefficients, and the body's, grow with the thickness so that all wear through in minutes. Elements
follow wear by a tenth of the thickness. Load and speed are our reading of the paper. Columns: the
coating; the largest difference of the approach (and p h |1/E - 1/E'|); the penetration at the end,
fixed and updated; the largest difference of depths of wear; when the first element is worn through;
the area mean of differences of pressure over the mean pressure, the largest and the last. All of
them every half second.
"""

import argparse
from pathlib import Path

import numpy as np

import ringwear_par as rw

CASE = Path(__file__).parent / "cases" / "wear_through.toml"
#: um and GPa
COATINGS = ((3.0, 100.0), (20.0, 100.0), (20.0, 500.0), (100.0, 100.0), (300.0, 1.0))
#: s, at which both are compared
TIMES = np.linspace(0.5, 300.0, 600)


def coated(thickness: float, modulus: float) -> rw.Case:
    """Return the case with a coating of so many um and GPa."""
    case = rw.read_case(CASE)
    faster = thickness / 3.0
    (layer,) = case.lower.layers
    assert layer.wear is not None
    return case.replace(
        {
            "lower.layers[0].thickness": 1e-3 * thickness,
            "lower.layers[0].young": 1e3 * modulus,
            "lower.layers[0].wear.k": 2e-8 * faster,
            "wear.lower.k": 1e-7 * faster,
            "output.times": TIMES.tolist(),
        }
    )


def row(thickness: float, modulus: float) -> str:
    """Return a row of the table."""
    case = coated(thickness, modulus)
    follow = {"mesh.geometry": "updated", "mesh.geometry_tolerance": 1e-4 * thickness}
    fixed, updated = (rw.simulate(each).to_xarray() for each in (case, case.replace(follow)))
    off = abs(fixed - updated)
    area = case.line.area / case.line.area.sum()
    pressure = (off.pressure.values @ area) / (updated.pressure.values @ area)
    estimate = 80.0 * thickness * abs(1.0 / (1e3 * modulus) - 1.0 / case.lower.young)
    told = [
        f"{thickness:g} um, {modulus:g} GPa",
        f"{1e3 * off.approach.max():.2g} um ({estimate:.2g})",
        f"{1e3 * fixed.penetration[-1]:.4g}, {1e3 * updated.penetration[-1]:.4g} um",
        f"{1e3 * off.wear_lower.max():.2g} um",
        f"{fixed.time_through_lower:.1f}, {updated.time_through_lower:.1f} s",
        f"{1e2 * pressure.max():.2g} %, {1e2 * pressure[-1]:.1g} %",
    ]
    return f"| {' | '.join(told)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("coatings", nargs="*", metavar="THICKNESS,MODULUS", help="um and GPa")
    words = parser.parse_args().coatings
    for thickness, modulus in [tuple(map(float, w.split(","))) for w in words] or COATINGS:
        print(row(thickness, modulus), flush=True)


if __name__ == "__main__":
    main()
