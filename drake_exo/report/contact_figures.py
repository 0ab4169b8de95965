"""The contact laws drawn: Figures 8 and 9 of the paper.

The paper prints the curves without their parameters; here they are stated
under each figure and can be chosen on the command line
(`drake-exo contact --out DIR`).
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from drake_exo.contact.hunt_crossley import (
    LAWS,
    friction_coefficient,
    paper_stiffness,
    sphere_force,
    sphere_force_derivatives,
)
from drake_exo.files.output import write_json

# Colours that stay apart in print and for colour-blind readers.
BLUE, ORANGE, GREY, SHADE = "#0072B2", "#D55E00", "#5F5F5F", "#E8E8E8"
_STYLE = {
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "savefig.dpi": 220,
    "mathtext.fontset": "dejavusans",
    "svg.hashsalt": "drake_exo",
}


@dataclass(frozen=True)
class ContactCurves:
    """What the figures are drawn for."""

    modulus: float = field(default=5e6, metadata={"unit": "N/m²", "above": 0})
    dissipation: float = field(
        default=2.0, metadata={"unit": "s/m", "minimum": 0}
    )
    radius: float = field(default=0.032, metadata={"unit": "m", "above": 0})
    static_friction: float = field(
        default=0.9, metadata={"unit": "", "above": 0}
    )
    dynamic_friction: float = field(
        default=0.6, metadata={"unit": "", "above": 0}
    )
    viscous_friction: float = field(
        default=0.5, metadata={"unit": "s/m", "minimum": 0}
    )
    transition_velocity: float = field(
        default=0.05, metadata={"unit": "m/s", "above": 0}
    )

    def constants(self, law: str):
        """Constants of a law with these friction values."""
        return LAWS[law](
            static_friction=self.static_friction,
            dynamic_friction=self.dynamic_friction,
            viscous_friction=self.viscous_friction,
            transition_velocity=self.transition_velocity,
        )

    def stiffness(self, law: str) -> float:
        """Stiffness in the law's own definition."""
        if law == "paper":
            return paper_stiffness(self.modulus)
        return self.modulus

    def normal(self, law: str, indentation, rate: float = 0.0):
        """Normal force [N] at indentations [m] and a rate [m/s]."""
        return sphere_force(
            law,
            indentation,
            rate,
            0.0,
            self.stiffness(law),
            self.dissipation,
            self.radius,
            self.constants(law),
        )[0]


def measures(curves: ContactCurves) -> dict:
    """Numbers behind the figures: small force and slope out of contact.

    Returns:
        largest force [N] and least slope [N/m] of the paper's law from 50 mm
        above the ground to touching it, at rest, and the peak and end of the
        friction coefficient without its viscous part.
    """
    x = np.linspace(-0.05, 0.0, 1001)
    away = sphere_force_derivatives(
        "paper",
        x,
        0.0,
        0.0,
        curves.stiffness("paper"),
        curves.dissipation,
        curves.radius,
        curves.constants("paper"),
    )
    dry = replace(curves.constants("paper"), viscous_friction=0.0)
    ratio = np.linspace(0.0, 4.0, 4001)
    mu = friction_coefficient("paper", ratio * dry.transition_velocity, dry)
    return {
        "parameters": curves,
        "force_out_of_contact_n": np.max(away.normal),
        "slope_out_of_contact_n_per_m": np.min(away.d_normal[0]),
        "peak_friction": np.max(mu),
        "peak_friction_at_v_rel": ratio[np.argmax(mu)],
        "friction_at_v_rel_3": mu[3000],
    }


def draw_normal_force(curves: ContactCurves):
    """Figure 8: normal force against indentation, zoom out of contact."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2, 3.6), layout="constrained")
    axes = figure.subplots()
    x = np.linspace(-0.05, 0.02, 2801)
    for rate, style, label in (
        (0.1, (0, (4, 1.5)), "sinking at 0.1 m/s"),
        (0.0, "-", "at rest"),
        (-0.1, (0, (1, 1.2)), "leaving at 0.1 m/s"),
    ):
        axes.plot(
            1e3 * x,
            curves.normal("paper", x, rate),
            color=BLUE,
            linestyle=style,
            label=f"paper, {label}",
        )
    axes.plot(
        1e3 * x,
        curves.normal("simbody", x),
        color=ORANGE,
        label="simbody, at rest",
    )
    axes.axvspan(-50.0, 0.0, color=SHADE, zorder=0)
    axes.set_xlim(-50.0, 21.0)
    axes.set_ylim(0.0, 1.05 * np.max(curves.normal("paper", x)))
    axes.set_xlabel("indentation (mm)")
    axes.set_ylabel("normal force (N)")
    axes.legend(loc="upper left", handlelength=2.2)
    axes.text(
        0.03,
        0.69,
        f"$E$ = {1e-6 * curves.modulus:g} N/mm², "
        f"$c$ = {curves.dissipation:g} s/m, "
        f"$r$ = {1e3 * curves.radius:g} mm",
        transform=axes.transAxes,
        va="top",
        fontsize=8.0,
        color=GREY,
    )
    _draw_zoom(axes, curves)
    return figure


def _draw_zoom(axes, curves: ContactCurves) -> None:
    """Inset of the shaded region: force below 1 N, slope not zero."""
    inset = axes.inset_axes((0.115, 0.12, 0.50, 0.42))
    x = np.linspace(-0.05, 0.0, 501)
    force = curves.normal("paper", x)
    inset.set_facecolor("white")
    inset.plot(1e3 * x, force, color=BLUE)
    inset.set_xlim(-50.0, 0.0)
    inset.set_ylim(0.0, 1.15 * np.max(force))
    inset.tick_params(labelsize=7.0)
    inset.spines[["top", "right"]].set_visible(True)
    inset.set_title(
        "zoom of the shaded part: paper, at rest", fontsize=7.5, pad=3.0
    )
    values = measures(curves)
    inset.text(
        0.06,
        0.92,
        f"force ≤ {_up(values['force_out_of_contact_n']):.2f} N\n"
        f"slope ≥ {-_up(-values['slope_out_of_contact_n_per_m']):.2f} N/m",
        transform=inset.transAxes,
        va="top",
        fontsize=7.5,
    )


def _up(value: float) -> float:
    """Rounded up to two decimals: a bound must stay one."""
    return np.ceil(100.0 * value) / 100.0


def draw_friction(curves: ContactCurves):
    """Figure 9: friction coefficient against v_rel = |slip|/v_t."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2, 3.4), layout="constrained")
    axes = figure.subplots()
    ratio = np.linspace(0.0, 5.0, 1001)
    speed = ratio * curves.transition_velocity
    paper = curves.constants("paper")
    dry = replace(paper, viscous_friction=0.0)
    axes.plot(
        ratio,
        friction_coefficient("paper", speed, dry),
        color=BLUE,
        label="paper, $\\mu_2$",
    )
    axes.plot(
        ratio,
        friction_coefficient("paper", speed, paper),
        color=BLUE,
        linestyle=(0, (4, 1.5)),
        label=r"paper, $\mu_1 + \mu_2$ ($u_v$ = "
        f"{curves.viscous_friction:g} s/m)",
    )
    simbody = replace(curves.constants("simbody"), viscous_friction=0.0)
    axes.plot(
        ratio,
        friction_coefficient("simbody", speed, simbody),
        color=ORANGE,
        linewidth=1.2,
        label="simbody, without viscous part",
    )
    for level, text, start in (
        (curves.static_friction, "$u_s$", 1.0),
        (curves.dynamic_friction, "$u_d$", 3.0),
    ):
        _mark_level(axes, level, text, start)
    axes.set_xlim(0.0, 5.0)
    axes.set_ylim(0.0, None)
    axes.set_xlabel(
        r"relative slip speed $v_\mathrm{rel} = v_\mathrm{slip} / v_t$"
    )
    axes.set_ylabel(r"friction coefficient $\mu$")
    axes.legend(
        loc="lower right",
        frameon=True,
        facecolor="white",
        edgecolor="none",
        framealpha=1.0,
    )
    return figure


def _mark_level(axes, level: float, text: str, start: float):
    """A friction coefficient on the axis, and where it is reached."""
    axes.plot([0.0, start], [level, level], color=GREY, linewidth=0.7, zorder=1)
    axes.plot([start, start], [0.0, level], color=GREY, linewidth=0.7, zorder=1)
    axes.annotate(
        text,
        (0.0, level),
        xytext=(4.0, 2.0),
        textcoords="offset points",
        color=GREY,
        fontsize=8.0,
    )


def write_figures(folder: Path, curves: ContactCurves) -> list[Path]:
    """Writes both figures as PNG and PDF and the numbers behind them.

    Args:
        folder: that exists.
        curves: what to draw.

    Returns:
        The files written.
    """
    import matplotlib

    files = []
    with matplotlib.rc_context(_STYLE):
        for name, draw in (
            ("figure_8_normal_force", draw_normal_force),
            ("figure_9_friction", draw_friction),
        ):
            figure = draw(curves)
            for suffix, metadata in (
                ("png", {"Software": None}),
                ("pdf", {"CreationDate": None}),
            ):
                files.append(Path(folder) / f"{name}.{suffix}")
                figure.savefig(files[-1], metadata=metadata)
    files.append(Path(folder) / "summary.json")
    write_json(files[-1], measures(curves))
    return files
