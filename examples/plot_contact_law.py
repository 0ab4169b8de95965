"""The contact law under the feet: stiffness, damping, friction.

A sphere is pressed into the ground and let go, slowly and quickly: the
Hunt-Crossley term opens a loop, whose area is the energy that is lost.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import drake_exo as dx

MODULUS, RADIUS = 5e6, 0.032  # N/m^2, m
LAWS = {"simbody": MODULUS, "paper": dx.contact.paper_stiffness(MODULUS)}
phase = np.linspace(0.0, np.pi, 201)
depth = 0.010 * np.sin(phase)
slip = np.linspace(-0.3, 0.3, 601)
fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for (law, stiffness), color in zip(LAWS.items(), ("C0", "C1"), strict=True):
    ball = dict(stiffness=stiffness, dissipation=2.0, radius=RADIUS)
    for seconds, style in ((2.0, ":"), (0.2, "-")):
        rate = 0.010 * np.pi / seconds * np.cos(phase)
        force, _ = dx.contact.sphere_force(law, depth, rate, 0.0, **ball)
        label = f"{law}, pressed for {seconds:g} s"
        left.plot(1e3 * depth, force, style, color=color, label=label)
        lost = np.sum((force[1:] + force[:-1]) / 2 * np.diff(depth))
        print(f"{label}: up to {force.max():.0f} N, {lost:.2f} J lost")
    _, friction = dx.contact.sphere_force(law, 0.01, 0.0, slip, **ball)
    right.plot(slip, friction, color=color, label=law)
left.set(xlabel="indentation [mm]", ylabel="normal force [N]")
right.set(xlabel="slip [m/s]", ylabel="friction [N]")
left.legend()
right.legend()

fig.savefig(Path(*sys.argv[1:2]) / "contact_law.png", dpi=150)
