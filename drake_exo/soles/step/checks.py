"""What a simulated step has to hold for its figures to mean something."""

import numpy as np

from drake_exo.files.verdict import SOLVED, Check

# Linear elasticity is some per cent off at the first, and turns elements
# inside out from the second on.
SMALL_STRAIN, _INSIDE_OUT = 0.3, 1.0
_TILT_DEG = 20.0  # beyond, a small-strain pose is not that of a real foot
_ZMP_ERROR = 0.02  # metres
_NEAR_SLIP = 0.95  # part of μ
_UNDERCUT = 0.01  # part of the bare surface
_COMPLEMENTARITY = 1e-6
_NOT_SMALL = (
    "small strain does not hold so far; judge the sole in finite strain "
    "(drake-exo sole strain)"
)
_TURNED_OVER = (
    "elements turn inside out, so that the figures mean nothing: the load is "
    "too large for this material and shape; check youngs_modulus_pa and the "
    "load's units"
)


def step_checks(step) -> tuple[Check, ...]:
    """Checks of a `Step`, see the table in docs/soles.md."""
    name = step.setup.name
    checks = [_solved(step)]
    if not step.converged.any():
        return tuple(checks)
    strain = step.largest_strain
    beyond_reason = strain >= _INSIDE_OUT
    limit = _INSIDE_OUT if beyond_reason else SMALL_STRAIN
    sentence = _TURNED_OVER if beyond_reason else _NOT_SMALL
    checks.append(
        Check(
            "plausibility.strain", strain < limit, strain, limit, "", name,
            "" if strain < limit else sentence,
            "fail" if beyond_reason else "note",
        )
    )  # fmt: skip
    measured = step.setup.load.is_measured
    if measured.any():
        checks.append(_zmp_check(step, name))
    if not measured.all():
        checks += _pose_checks(step, name, step.converged & ~measured)
    used = float(step.setup.load.friction_used.max())
    limit = _NEAR_SLIP * step.law.friction
    checks.append(
        _note(
            "plausibility.friction", used <= limit, used, limit, "", name,
            "the sole is about to slip away as a whole",
        )
    )  # fmt: skip
    undercut = step.sole.mesh.undercut
    checks.append(
        _note(
            "plausibility.undercut", undercut <= _UNDERCUT, undercut,
            _UNDERCUT, "", name,
            "so much of the bare surface faces upwards: a rigid mould that "
            "opens upwards does not let go of the sole",
        )
    )  # fmt: skip
    if step.law.layer == step.law.kappa == 0:
        worst = step.complementarity()
        holds = worst <= _COMPLEMENTARITY
        checks.append(
            Check(
                "contact", holds, worst, _COMPLEMENTARITY, "", name,
                "" if holds else "forces do not obey Signorini's and "
                "Coulomb's laws: the simulation went wrong",
            )
        )  # fmt: skip
    return tuple(checks)


def _pose_checks(step, name, free) -> list[Check]:
    """Of samples (N,) whose pose follows from the load."""
    if not free.any():
        return []
    tilt = float(step.tilt_deg[free].max())
    margin = float(np.nanmin(step.stability[free]))
    loose = int(np.sum(step.stability[free] <= 0))
    return [
        _note(
            "plausibility.tilt", tilt <= _TILT_DEG, tilt, _TILT_DEG, "°", name,
            "the foot leans far over: a small push may tip it",
        ),
        _note(
            "plausibility.stability", margin > 0, margin, 0.0, "N/m", name,
            f"{loose} samples are not shown to be stable: under a force that "
            "stays as it is the foot may tip there",
        ),
    ]  # fmt: skip


def _zmp_check(step, name) -> Check:
    """Of a prescribed pose: whether the load's ZMP comes out."""
    return _note(
        "plausibility.zmp", step.zmp_error <= _ZMP_ERROR, step.zmp_error,
        _ZMP_ERROR, "m", name,
        "the pose that markers tell leads to another centre of pressure: a "
        "tenth of a degree matters on a flat sole; take pose: free for its "
        "stiffness there",
    )  # fmt: skip


def _note(name, holds, value, limit, unit, where, sentence) -> Check:
    said = "" if holds else sentence
    return Check(name, bool(holds), value, limit, unit, where, said, "note")


def _solved(step) -> Check:
    failed = np.flatnonzero(~step.converged)
    if not len(failed):
        return Check(SOLVED, True, where=step.setup.name)
    q = failed[0]
    return Check(
        SOLVED, False, float(len(failed)), 0.0, "samples", step.setup.name,
        f"sample {q} at {step.times[q]:g} s: {step.history.statuses()[q]}",
    )  # fmt: skip
