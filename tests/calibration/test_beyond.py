"""What is not kept today, and angles that encoders tell wrongly."""

from dataclasses import replace

import numpy as np
import pytest
from test_design_program import SETTINGS
from worn import as_guessed
from worn import wearer as worn

from drake_exo.calibration.design import DesignProblem
from drake_exo.calibration.design_result import largest_deflections
from drake_exo.calibration.settings import DesignLimits
from drake_exo.calibration.wearers import assisted
from drake_exo.contact.assistance import Gains
from drake_exo.contact.parameters import Posterior
from drake_exo.contact.strap import Design
from drake_exo.model.plant import nominal_model
from drake_exo.nlp.program import quadratic_cost


@pytest.fixture(scope="module")
def wearer():
    return worn(nominal_model("coupled"))


def test_migration_beyond_its_limit_costs_as_all_forces_do(wearer):
    """Half the objective's weight for all of it, in proportion, either way."""
    today = as_guessed(DesignProblem([wearer], SETTINGS, held=True))
    slid = largest_deflections(today)["somebody"]
    limit = 1e3 * 0.5 * min(d[0] for d in slid.values())
    settings = replace(
        SETTINGS, weight=3.0, limits=DesignLimits(migration_mm=limit)
    )
    problem = DesignProblem([wearer], settings, today=today)
    (part,) = problem.parts
    _, slope, _ = quadratic_cost(problem.program.prog)
    indices = problem.program.indices
    rows = {
        str(b.evaluator().get_description()): []
        for b in problem.program.prog.linear_constraints()
    }
    for b in problem.program.prog.linear_constraints():
        rows[str(b.evaluator().get_description())].append(b)
    (movement,) = part.movements
    for cuff, deflection in slid.items():
        over = deflection[0] - 1e-3 * limit
        beyond = part._beyond[cuff]
        assert slope[indices(beyond)[0]] == pytest.approx(0.5 * 3.0 / over)
        name = f"{movement.name} {cuff} migration beyond its limit"
        x = np.zeros(problem.program.prog.num_vars())
        x[indices(beyond)] = 0.3 * over
        at = indices(part._slid[cuff, movement.name]).ravel()
        kept = []
        for far, holds in (
            (0.29, True),
            (-0.29, True),
            (0.31, False),
            (-0.31, False),
        ):
            x[at] = np.sign(far) * (1e-3 * limit + abs(far) * over)
            kept.append(
                all(
                    (
                        b.evaluator().GetDenseA()
                        @ x[indices(np.asarray(b.variables()))]
                        <= b.evaluator().upper_bound()
                    ).all()
                    for b in rows[name]
                )
            )
            assert kept[-1] == holds


def test_a_controller_acts_at_true_angles(wearer):
    """Those of encoders less what a calibration found them to be off."""
    (own,) = wearer.trials
    names = ("encoder.exo_knee", "encoder.exo_hip")
    known = Posterior(names, np.array([0.05, -0.02]), 1e-6 * np.eye(2))
    contact = replace(wearer.contact, posterior=known)
    spring = Gains(1.0, 0.0, 8.0, 0.0)
    design = Design(gains={"exo_knee": spring, "exo_hip": spring})
    changed = assisted(own, design, contact, friction=0.7)
    for joint, off in (("exo_knee", 0.05), ("exo_hip", -0.02)):
        more = -8.0 * (own.coordinate(joint) - off)
        np.testing.assert_allclose(
            changed.moment(joint) - own.moment(joint), more
        )
    half = Design(gains={"exo_hip": Gains(0.5)})
    changed = assisted(own, half, contact, friction=0.7)
    # Friction is there whatever the drive gives.
    expected = 0.5 * (own.moment("exo_hip") - 0.7) + 0.7
    np.testing.assert_allclose(changed.moment("exo_hip"), expected)
