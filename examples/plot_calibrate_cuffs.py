"""Calibrate the cuffs between person and exoskeleton (Phase B).

Three rises in a passive device on known cuffs, seen with an instrument's
noise: mats at the pelvis in two trials, at shank and thigh in the third.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import drake_exo as dx

noise = dx.synthetic.INSTRUMENT_NOISE
made = dx.synthetic.rises_in_device(3, nodes_per_second=50)
trials = [dx.synthetic.noisy(t, i, noise) for i, t in enumerate(made.trials)]
settings = dx.InteractionSettings(noise=noise)
study = dx.Study(made.model, trials, interaction=settings)
found = dx.calibrate_interaction(study, trials, made.contact)
print(found.solution.status, "in", found.solution.iterations, "iterations")

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
truth, known = made.contact.values(), found.uncertainty()
for name, half in zip(known.names, known.half_width, strict=True):
    if name.endswith("stiffness"):
        value, true = found.parameter(name).nominal, truth[name]
        print(f"{name:28s} {value:6.0f} ± {half:5.0f}, true {true:.0f}")
        left.errorbar(value / true, name, xerr=half / true, fmt="C0o")
left.axvline(1.0, color="0.6", ls=":")
left.set(xlim=(0.0, 2.5), xlabel="found / true, with 95 % intervals")
for seen, model in zip(trials, found.trials, strict=True):
    for cuff, mat in seen.cuffs.items():
        right.plot(seen.times, mat.normal, "0.7", lw=4)
        label = f"{seen.name}, {cuff}"
        right.plot(model.times, model.cuff(cuff).normal, label=label)
right.set(xlabel="time [s]", ylabel="normal force [N]; grey: mats")
right.legend(fontsize=8)
fig.savefig(Path(*sys.argv[1:2]) / "calibrate_cuffs.png", dpi=150)
