"""
Contact that grows over a crowned face
======================================

A steel ring whose face is round (radius of the crown 500 mm) on a bronze disc. It touches along
0.4 mm of its width at first; wear makes the contact creep outwards until the whole face carries.
"""

import matplotlib.pyplot as plt

import ringwear_par as rw

case = rw.read_case(
    {
        "lower": {"r": [5, 20], "z": [0, 10], "young": "110 GPa", "poisson": 0.34},
        "upper": {
            "r": [10, 15], "z": [10, 20], "young": "210 GPa", "poisson": 0.3,
            "profile": {"crown": 500.0},  # mm
        },
        "contact.friction": 0.1,
        "wear.upper": {"law": "archard", "k": 1e-7},
        "load": {"force": "500 N", "omega": "6 rad/s"},
        "time": {"scheme": "adaptive", "end": "1200 s"},
        # contact creeps over all of the face: equal elements
        "mesh": {"contact_elements": 256, "grading": 1.0},
    }
)  # fmt: skip
result = rw.simulate(case)

time, pressure = result.histories["time"], result.profiles["pressure"]
figure, axes = plt.subplots(figsize=(4.6, 3.2))
for wanted in (0, 10, 60, 300, 1200):  # s
    step = abs(time - wanted).argmin()
    axes.plot(result.line.r, pressure[step], label=f"{time[step]:.0f} s")
axes.set_xlim(10.0, 15.0)
axes.set_yscale("log")
axes.set_ylim(0.5, 100.0)
axes.set_xlabel("distance to axis (mm)")
axes.set_ylabel("contact pressure (MPa)")
axes.legend()
plt.show()
