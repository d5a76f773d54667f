"""
Stress along the interface under a hard coating
===============================================

A coating of 0.05 mm on a polymer disc, pressed by a steel ring. The coating is likely to come off
where its interface is sheared most, or pulled (normal stress above zero): beside the edges of the
contact.
"""

import matplotlib.pyplot as plt

import ringwear_par as rw

coating = {"thickness": "50 um", "young": "100 GPa", "poisson": 0.3}
case = rw.read_case(
    {
        "lower": {
            "r": [20, 40], "z": [0, 20], "young": "4 GPa", "poisson": 0.38, "layers": [coating],
        },
        "upper": {"r": [28.5, 31.5], "z": [20, 40], "young": "210 GPa", "poisson": 0.3},
        "contact.friction": 0.1,
        "wear.lower": {"law": "archard", "k": 1e-9},
        "load": {"pressure": "20 MPa", "omega": 3.5},
        "time": {"scheme": "adaptive", "end": "10 s"},
        "stress": {"times": [10.0]},
    }
)  # fmt: skip
data = rw.simulate(case).to_xarray()

stress = data.interface_stress_lower.isel(stress_step=-1, interface_lower=0).sel(side="above")
figure, axes = plt.subplots(figsize=(4.6, 3.2))
for component, label in {"zz": "normal", "rz": "shear in the section", "tz": "friction"}.items():
    axes.plot(data.interface_r_lower, stress.sel(component=component), label=label)
axes.set_xlim(27.0, 33.0)
axes.set_xlabel("distance to axis (mm)")
axes.set_ylabel("stress on the interface (MPa)")
axes.legend(loc="lower center")
plt.show()
