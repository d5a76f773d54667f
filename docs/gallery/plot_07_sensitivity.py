"""
Sensitivity of the worn profile to each number of the case
==========================================================

How much deeper the worn profile is after 200 s if a number of the case is one per cent larger: the
case and its neighbours are computed side by side.
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
neighbours = [case.replace({key: 1.01 * number}) for key, (number, _) in numbers.items()]
base, *others = rw.simulate_all([case, *neighbours])

figure, axes = plt.subplots(figsize=(4.6, 3.2))
for other, (_, name) in zip(others, numbers.values(), strict=True):
    deeper = other.profiles["wear_lower"][-1] - base.profiles["wear_lower"][-1]
    axes.plot(base.line.r, 1e3 * deeper, label=name)
axes.axhline(0.0, color="0.4", linestyle="-", linewidth=0.8)
axes.set_xlim(28.5, 31.5)
axes.set_xlabel("distance to axis (mm)")
axes.set_ylabel("more wear (\N{MICRO SIGN}m) for 1 % more")
axes.legend()
plt.show()
