"""Phase A: calibrate the foot-ground contact from several trials at once.

Serrancoli et al., II-C: kinematics, ground reaction and centre of pressure
are tracked, joint torques minimised; the spheres' parameters are shared by
all trials; initial and final states are given; human and exoskeleton do not
touch.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from drake_exo.calibration.problem import (
    Parts,
    PhaseProblem,
    PhaseResult,
    ground_terms,
    kinematic_terms,
    typical_jerk,
)
from drake_exo.calibration.scores import rmsd
from drake_exo.calibration.settings import FootGroundSettings
from drake_exo.collocation.trial_program import minimised
from drake_exo.contact.parameters import (
    ContactModel,
    ContactParameter,
    GroundContact,
)
from drake_exo.files.output import Progress
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model


class FootGroundCalibration(PhaseProblem):
    """Phase A posed as a MathematicalProgram.

    Args:
        model: subject and device.
        trials: measured.
        settings: noise, bounds, grid.
        parameters: to calibrate; those of the settings by default.
        ground: contact that is known, of a sole; then there are none.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> model, (trial,) = synthetic.rises_on_spheres(1, nodes_per_second=40)
    >>> posed = FootGroundCalibration(model, [trial])
    >>> posed.program.prog.num_vars() > 1000
    True
    """

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        settings: FootGroundSettings | None = None,
        parameters: list[ContactParameter] | None = None,
        *,
        ground: GroundContact | None = None,
        refined: Mapping[str, Parts] | None = None,
    ):
        settings = settings or FootGroundSettings()
        if ground is None:
            contact = settings.contact(model.spheres)
            parameters = parameters or settings.parameters(model.spheres)
        else:
            contact = ContactModel(ground, jerk=typical_jerk(trials))
            parameters = []
        super().__init__(
            model, trials, contact, parameters, settings, refined=refined
        )

    def _terms(self, movement, at, effects):
        noise = self.settings.noise
        return [
            *kinematic_terms(movement, at, noise),
            *ground_terms(movement, at, noise),
            minimised(movement.torque, noise.torque_nm),
        ]


FRONT_KINDS = ("angles_deg", "velocities_deg_s", "grf_n", "cop_mm")


def pareto_front(result: PhaseResult) -> list[dict]:
    """Calibrate again with the noise of forces scaled by factors.

    Args:
        result: of Phase A with the settings as they stand, which name the
            factors.

    Returns:
        One row for each factor: factor, success, and of each of FRONT_KINDS the
        mean and the worst RMSD.
    """
    problem = result.problem
    settings, noise = problem.settings, problem.settings.noise
    rows = []
    factors = sorted({1.0, *settings.front})
    progress = Progress("front", total=len(factors))
    for i, factor in enumerate(factors):
        found = result
        if factor != 1.0:
            scaled = replace(
                noise,
                force_n=factor * noise.force_n,
                cop_m=factor * noise.cop_m,
            )
            found = FootGroundCalibration(
                problem.model,
                problem.trials,
                replace(settings, noise=scaled),
                problem.parameters,
            ).solve(near=result)
        rows.append(_row(factor, found))
        progress.update(f"factor {factor:g}", done=i + 1)
    return rows


def _row(factor: float, found: PhaseResult) -> dict:
    success = found.success
    found = found if success else found.unsealed()
    scores = [
        rmsd(t, measured)
        for t, measured in zip(found.trials, found.problem.trials, strict=True)
    ]
    row = {"factor": factor, "success": success}
    for kind in FRONT_KINDS:
        values = np.hstack(
            [
                list(s[kind].values()) if isinstance(s[kind], dict) else s[kind]
                for s in scores
            ]
        )
        row[kind] = float(np.mean(values))
        row[f"{kind}_worst"] = float(np.max(values))
    return row
