"""A humanoid's soft sole through a step, in two thicknesses.

The walking pattern gives force and zero-moment point; pose, contact forces
and the stiffness that the ankle feels follow.
"""

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

import drake_exo as dx

CASE = """
name: gallery
mesh: {{brick: {{size_m: [0.23, 0.13, {thickness}], divisions: [10, 6, 2]}}}}
material: {{name: neoprene}}
load: {{pattern: {{}}}}
"""
fig, axes = plt.subplots(2, 2, figsize=(10, 6), layout="constrained")
for thickness, pressed in zip((0.02, 0.04), axes[1], strict=True):
    case = dx.soles.Case.from_text(CASE.format(thickness=thickness))
    step = replace(case, load=case.load.every(40)).simulate()
    label = f"{1e3 * thickness:.0f} mm"
    print(f"{label}: c_tr {step.c_tr:.3g} N/m, c_rot {step.c_rot:.3g} N m/rad")
    axes[0, 0].semilogy(step.times, step.sigma_max_translation, label=label)
    axes[0, 1].plot(step.times, step.sigma_min_rotation, label=label)
    nodes = 1e3 * case.mesh.nodes[case.mesh.contact]
    under, middle = nodes[:, 2] < nodes[:, 2].min() + 1.0, len(step.times) // 2
    x, y, _ = nodes[under].T
    shown = pressed.tricontourf(x, y, 1e-3 * step.pressure[middle, under], 20)
    fig.colorbar(shown, ax=pressed, label="pressure [kPa]")
    pressed.set(title=f"{label}, half-way", aspect="equal")
    pressed.set(xlabel="forward [mm]", ylabel="left [mm]")
axes[0, 0].set(xlabel="time [s]", ylabel="stiffest translation [N/m]")
axes[0, 1].set(xlabel="time [s]", ylabel="softest rotation [N m/rad]")
axes[0, 0].legend()
fig.savefig(Path(*sys.argv[1:2]) / "soft_sole.png", dpi=150)
