"""
Both bodies wear
================

The disc wears where the pressure is above 60 MPa, the ring at any pressure. Their wear together
evens the pressure out; the share of each body differs along the radius.
"""

import matplotlib.pyplot as plt

import ringwear_par as rw

case = rw.read_case(
    {
        "lower": {"r": [20, 40], "z": [0, 20], "young": "10 GPa", "poisson": 0.3},
        "upper": {"r": [28.5, 31.5], "z": [20, 40], "young": "100 GPa", "poisson": 0.3},
        "contact.friction": 0.1,
        "wear.lower": {"law": "threshold", "k": 1e-7, "p0": "60 MPa"},
        "wear.upper": {"law": "threshold", "k": 3e-8},
        "load": {"pressure": "80 MPa", "omega": 85 / 24},
        "time": {"scheme": "adaptive", "end": "200 s"},
    }
)
result = rw.simulate(case)

r = result.line.r
figure, axes = plt.subplots(figsize=(4.6, 3.2))
axes.plot(r, 1e3 * result.profiles["wear_upper"][-1], label="upper ring")
axes.plot(r, -1e3 * result.profiles["wear_lower"][-1], label="lower disc")
axes.margins(y=0.15)
axes.axhline(0.0, color="0.4", linestyle="-", linewidth=0.8)
axes.set_xlim(28.5, 31.5)
axes.set_xlabel("distance to axis (mm)")
axes.set_ylabel("height of worn faces after 200 s (\N{MICRO SIGN}m)")
axes.legend()
plt.show()
