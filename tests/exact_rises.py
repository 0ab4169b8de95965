"""Exact rises in a device, with the phases and settings of tests on them."""

from dataclasses import replace

from drake_exo.calibration.error_model import NO_ERRORS
from drake_exo.calibration.phases import (
    InteractionCalibration,
    PredictionProblem,
)
from drake_exo.calibration.settings import (
    InteractionNoise,
    InteractionSettings,
    PredictionSettings,
    Solver,
)
from drake_exo.contact.parameters import ContactModel
from drake_exo.measurement.trial import Trial
from drake_exo.virtual_laboratory.synthetic import (
    RisesInDevice,
    rises_in_device,
)


def exact_rises(*given, **named) -> "ExactRises":
    """As `rises_in_device`."""
    return ExactRises(**vars(rises_in_device(*given, **named)))


class ExactRises(RisesInDevice):
    def settings(self, **changes) -> InteractionSettings:
        """Settings of Phase B on the grid of the data."""
        solver = Solver(self.nodes_per_second, tolerance=1e-6)
        usual = InteractionSettings(solver=solver, errors=NO_ERRORS)
        return replace(usual, **changes)

    def exact_settings(self) -> InteractionSettings:
        """Settings of Phase B with nearly no regularisation, for exact data."""
        noise = InteractionNoise(normal_force_n=0.5, energy_j=1e3, jerk=1e5)
        solver = Solver(self.nodes_per_second, tolerance=1e-9)
        return self.settings(noise=noise, prior_weight=1e-9, solver=solver)

    def calibration(
        self, settings: InteractionSettings, trials=None
    ) -> InteractionCalibration:
        """Phase B on these trials, or on others."""
        return InteractionCalibration(
            self.model, trials or self.trials, self.contact, settings
        )

    def prediction(
        self,
        settings: PredictionSettings,
        trial: Trial,
        contact: ContactModel | None = None,
        controller=None,
    ) -> PredictionProblem:
        """Phase C of one trial, with the true contact or another.

        Errors of measurement are switched off, since these data have none.
        """
        return PredictionProblem(
            self.model,
            [trial],
            contact or self.contact,
            replace(settings, errors=NO_ERRORS),
            controller=controller,
        )
