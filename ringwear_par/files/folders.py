"""The folders of fits and of designs: what their files are called, and what draws them."""

from pathlib import Path

from ringwear_par.errors import InputError

#: of a fit: its outcome, which is written the last, its readings and two figures
FIT, READINGS, CURVES, ESTIMATES = "fit.json", "results.h5", "fit.png", "parameters.png"
#: of a fit with scatter: the values of specimens
SPECIMENS = "specimens.png"
#: of a design: its outcome, which is written the last, the best tests and the map of all
DESIGN, NEXT, MAP = "design.json", "next.toml", "design.png"


def refuse_drawn(folder: Path) -> None:
    """Refuse to draw the folder of a fit or a design anew. Not collective.

    Raises
    ------
    InputError : it is one; with the pictures that are there.
    """
    for outcome, of, pictures in (
        (FIT, "fit", f"pictures {CURVES} and {ESTIMATES} are"),
        (DESIGN, "design", f"picture {MAP} is"),
    ):
        if (folder / outcome).exists():
            raise InputError(
                f"{folder}: is the folder of a {of}, whose {pictures} there already (a page of it "
                "is made by ringwear report); must be that of a sweep, or a result file"
            )
