"""What tests of the phases share: movements of known truth, and solves."""

from pathlib import Path

import pytest
from undrawn import undrawn

from drake_exo.calibration.settings import (
    FootGroundSettings,
    PredictionSettings,
    Range,
    Solver,
    SphereSettings,
)
from drake_exo.cli import main
from drake_exo.model.plant import nominal_model
from drake_exo.virtual_laboratory import synthetic

_STUDY = Path(__file__).parents[1] / "studies" / "opencap_predict.yaml"


@pytest.fixture(scope="session")
def command(data_root):
    """A command's arguments for five rises of a real recording."""
    return lambda name: [name, str(_STUDY), "--data-root", str(data_root)]


@pytest.fixture(scope="session")
def calibrated(command, tmp_path_factory):
    """Folder with the contact that three of them calibrate."""
    out = tmp_path_factory.mktemp("recorded") / "calibrated"
    options = ["--phase", "foot-ground", "--no-front", "--out", str(out)]
    with undrawn():
        assert main([*command("calibrate"), *options]) == 0
    return out


@pytest.fixture(scope="session")
def in_device():
    """Three exact trials with known cuffs, 50 nodes a second."""
    return synthetic.rises_in_device()


@pytest.fixture(scope="session")
def exact(in_device):
    """Phase B of them, its regularisers nearly zero."""
    return in_device.calibration(in_device.exact_settings()).solve()


@pytest.fixture(scope="session")
def regular(in_device):
    """Phase B of them with the usual regularisers."""
    return in_device.calibration(in_device.settings()).solve()


@pytest.fixture(scope="session")
def predicted(in_device):
    """Phase C1 of the first, from a line."""
    settings = PredictionSettings(solver=Solver(50.0))
    return in_device.prediction(settings, in_device.trials[0]).solve()


@pytest.fixture(scope="session")
def human():
    """The model without exoskeleton."""
    return nominal_model("human")


@pytest.fixture(scope="session")
def defaults():
    """Heel and toe of one material, 40 nodes a second."""
    sphere = SphereSettings(
        modulus_n_m2=Range(4e6, 5e5, 2e7), dissipation_s_m=Range(1.0, 0.0, 5.0)
    )
    return FootGroundSettings(
        heel=sphere, toe=sphere, solver=Solver(nodes_per_second=40.0)
    )


@pytest.fixture(scope="session")
def nominal(human, defaults):
    """Contact parameters of the nominal human's foot."""
    return defaults.parameters(human.spheres)
