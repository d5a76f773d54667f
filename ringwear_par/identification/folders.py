"""What the files in the folders of fits and of designs are called."""

#: of a fit: its outcome, which is written the last, its readings and two figures
FIT, READINGS, CURVES, ESTIMATES = "fit.json", "results.h5", "fit.png", "parameters.png"
#: of a design: its outcome, which is written the last, the best tests and the map of all
DESIGN, NEXT, MAP = "design.json", "next.toml", "design.png"
