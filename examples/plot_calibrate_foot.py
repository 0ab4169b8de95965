"""Calibrate the contact of foot and ground from three rises (Phase A).

The rises are made with known spheres and get an instrument's noise; the
calibration starts elsewhere and has to find the spheres again.
"""

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

import drake_exo as dx

noise = dx.synthetic.INSTRUMENT_NOISE
model, exact = dx.synthetic.rises_on_spheres(3, nodes_per_second=50)
trials = [dx.synthetic.noisy(trial, i, noise) for i, trial in enumerate(exact)]
settings = dx.FootGroundSettings(noise=noise)
truth = settings.contact(model.spheres).values()
hard = replace(settings.heel.modulus_n_m2, nominal=3e7)
away = replace(settings.heel.x_m, shift=0.02)
wrong = replace(settings.heel, modulus_n_m2=hard, x_m=away)
study = dx.Study(model, trials, foot_ground=replace(settings, heel=wrong))
found = dx.calibrate_foot_ground(study)
print(found.solution.status, "in", found.solution.iterations, "iterations")

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
known = found.uncertainty()
for name, half in zip(known.names, known.half_width, strict=True):
    value, true = found.parameter(name).nominal, truth[name]
    print(f"{name:16s} {value:10.4g} ± {half:8.2g}, true {true:.4g}")
    left.errorbar(value / true, name, xerr=half / abs(true), fmt="C0o")
left.set_xlabel("found / true, with 95 % intervals")
for k, (seen, model) in enumerate(zip(trials, found.trials, strict=True)):
    right.plot(seen.times, 1e3 * seen.ground.cop_x, f"C{k}", lw=3, alpha=0.4)
    right.plot(model.times, 1e3 * model.ground.cop_x, f"C{k}", label=seen.name)
right.set(xlabel="time [s]", ylabel="centre of pressure [mm]; pale: measured")
right.legend()
fig.savefig(Path(*sys.argv[1:2]) / "calibrate_foot.png", dpi=150)
