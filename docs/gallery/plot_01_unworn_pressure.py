"""
Pressure before any wear
========================

The paper's rings under a mean pressure of 50 MPa. How the pressure rises towards an edge depends on
the shape and the modulus of the body under it: here it grows without bound, the faster the softer
the disc is. The axis ends at 150 MPa.
"""

import matplotlib.pyplot as plt

import ringwear_par as rw

case = rw.read_case(
    {
        "lower": {"r": [20, 40], "z": [0, 20], "young": "10 GPa", "poisson": 0.3},
        "upper": {"r": [28.5, 31.5], "z": [20, 40], "young": "100 GPa", "poisson": 0.3},
        "contact.friction": 0.1,
        "load": {"pressure": "50 MPa", "omega": 1.0},
        "time": {"step": 1.0, "steps": 1},  # nothing wears: the first state is the answer
        "mesh.contact_elements": 128,
    }
)

figure, axes = plt.subplots(figsize=(4.6, 3.2))
for young in (10e3, 100e3, 1000e3):
    result = rw.simulate(case.replace({"lower.young": young}))
    ratio = young / case.upper.young
    axes.plot(result.line.r, result.profiles["pressure"][0], label=f"{ratio:g}")
axes.axhline(50.0, color="0.6", linewidth=0.8, linestyle=(0, (1, 2)))
axes.text(31.53, 50.0, "mean", va="center", color="0.4")
axes.set_xlim(28.5, 31.5)
axes.set_ylim(0.0, 150.0)
axes.set_xlabel("distance to axis (mm)")
axes.set_ylabel("contact pressure (MPa)")
axes.legend(title="disc's modulus over ring's", loc="upper center")
plt.show()
