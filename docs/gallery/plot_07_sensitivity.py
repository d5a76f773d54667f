"""
Sensitivity of the worn profile to each number of the case
==========================================================

Derivatives of the worn profile after 200 s with respect to numbers of the case, each scaled by its
number: how much deeper the wear is if the number is one per cent larger. The derivatives are exact,
and computed with the history.
"""

import matplotlib.pyplot as plt

import ringwear_par as rw

numbers = {
    "wear.lower.k": (1e-7, "wear coefficient"),
    "load.pressure": (80.0, "mean pressure"),
    "wear.lower.p0": (40.0, "threshold pressure"),
}
case = rw.read_case(
    {
        "lower": {"r": [20, 40], "z": [0, 20], "young": "10 GPa", "poisson": 0.3},
        "upper": {"r": [28.5, 31.5], "z": [20, 40], "young": "100 GPa", "poisson": 0.3},
        "contact.friction": 0.1,
        "wear.lower": {"law": "threshold"},
        "load.omega": 85 / 24,
        "time": {"scheme": "adaptive", "end": "200 s"},
        **{key: number for key, (number, _) in numbers.items()},
    }
)
result = rw.simulate(case, derivatives=list(numbers))

figure, axes = plt.subplots(figsize=(4.6, 3.2))
for number, (value, name) in enumerate(numbers.values()):
    slope = result.derivatives["d_wear_lower"][number, -1]
    axes.plot(result.line.r, 1e3 * 0.01 * value * slope, label=name)
axes.axhline(0.0, color="0.4", linestyle="-", linewidth=0.8)
axes.set_xlim(28.5, 31.5)
axes.set_xlabel("distance to axis (mm)")
axes.set_ylabel("more wear (\N{MICRO SIGN}m) for 1 % more")
axes.legend()
plt.show()
