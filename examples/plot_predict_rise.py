"""Predict a rise from its end states, with three sets of cuffs (Phase C).

No kinematics are tracked: motion and forces in the cuffs are found. Stiffer
cuffs keep the device nearer to the person.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import drake_exo as dx

made = dx.synthetic.rises_in_device(1, nodes_per_second=50)
(trial,) = made.trials
study = dx.Study(made.model, made.trials)
fig = plt.figure(figsize=(10, 6), layout="constrained")
above, below = fig.subfigures(2, 1)
left, right = below.subplots(1, 2)
for scale in (0.5, 2.0, 1.0):
    found = dx.predict(study, trial, made.contact, scale_interaction=scale)
    off = found.rmsd(trial)["angles_deg"]
    print(f"cuffs x {scale}: {found.solution.status}; hip off by", end=" ")
    print(f"{off['hip']:.2f} deg, device's hip by {off['exo_hip']:.2f} deg")
    lead = found.coordinate("exo_hip") - found.coordinate("hip")
    left.plot(found.times, np.rad2deg(lead), label=f"cuffs x {scale}")
    right.plot(found.times, found.cuff("pelvis").normal)
left.set(xlabel="time [s]", ylabel="device's hip before the person's [°]")
right.set(xlabel="time [s]", ylabel="normal force at the pelvis [N]")
left.legend()
scene = dx.Scene(made.model)
for axis, t in zip(above.subplots(1, 5), np.linspace(0, 1.5, 5), strict=True):
    (q,) = found.sample(np.array([t])).q
    axis.imshow(scene.render(q, width=300, height=400))
    axis.set(title=f"{t:.2f} s")
    axis.axis("off")
fig.savefig(Path(*sys.argv[1:2]) / "predict_rise.png", dpi=150)
