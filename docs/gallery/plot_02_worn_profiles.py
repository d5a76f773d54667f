"""
Worn profiles in time
=====================

The paper's case (figure 2, left): the lower ring wears where the pressure is above 40 MPa. Wear
begins under the edges of the upper ring, where the pressure is highest, and stays deepest there.
"""

import matplotlib.pyplot as plt
import numpy as np

import ringwear_par as rw

case = rw.read_case(
    {
        "lower": {"r": [20, 40], "z": [0, 20], "young": "10 GPa", "poisson": 0.3},
        "upper": {"r": [28.5, 31.5], "z": [20, 40], "young": "100 GPa", "poisson": 0.3},
        "contact.friction": 0.1,
        "wear.lower": {"law": "threshold", "k": 1e-7, "p0": "40 MPa"},
        "load": {"pressure": "80 MPa", "omega": 85 / 24},
        "time": {"scheme": "adaptive", "end": "200 s"},
        "output.times": [1, 50, 100, 150, 200],
    }
)
result = rw.simulate(case)

time, depth = result.histories["time"], 1e3 * result.profiles["wear_lower"]
figure, axes = plt.subplots(figsize=(4.6, 3.2))
for t, profile in list(zip(time, depth, strict=True))[1:]:
    axes.plot(result.line.r, -profile, label=f"{t:g} s")
for beside in ([28.0, 28.5], [31.5, 32.0]):  # the disc beyond the ring is not touched
    axes.plot(beside, np.zeros(2), color="0.4", linestyle="-", linewidth=0.8)
axes.set_xlim(28.0, 32.0)
axes.set_xlabel("distance to axis (mm)")
axes.set_ylabel("worn surface of the lower ring (\N{MICRO SIGN}m)")
figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=5)
plt.show()
