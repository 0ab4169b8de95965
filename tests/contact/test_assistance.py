"""Torques that a design makes of today's: law, LeafSystem, laboratory."""

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, InitializeAutoDiff
from pydrake.symbolic import Expression, MakeVectorVariable

from drake_exo.contact.strap import (
    Assistance,
    Design,
    GainController,
    GainController_,
    Gains,
)
from drake_exo.errors import InputError

KNEE, HIP = Gains(0.8, 1.5, 6.0, 0.4), Gains(1.1, -2.0, 0.0, 1.2)
STATE = np.array([0.9, -0.4, 0.7, -1.1])  # angles, rates
TODAY = np.array([-20.0, -12.0])
# By hand, from the equation.
KNEE_NM = 0.8 * -20.0 + 1.5 - 6.0 * 0.9 - 0.4 * 0.7
HIP_NM = 1.1 * -12.0 - 2.0 - 1.2 * -1.1
BOTH = [KNEE_NM, HIP_NM]


def asked(system, today=TODAY, state=STATE):
    context = system.CreateDefaultContext()
    system.GetInputPort("exoskeleton_state").FixValue(context, state)
    if today is not None:
        system.GetInputPort("today_torques").FixValue(context, today)
    return context, system.GetOutputPort("exoskeleton_torques")


@pytest.mark.parametrize(
    ("gains", "words"),
    [
        (Gains(stiffness_nm_rad=-1.0), "stiffness_nm_rad is -1"),
        (Gains(np.nan), "support is .nan"),
        (0.5, "give a Gains"),
    ],
)
def test_gains_that_no_design_may_have_are_refused(gains, words):
    with pytest.raises(InputError, match=words):
        GainController([Gains(), gains])


def test_law_design_and_system_are_one():
    design = Design(gains={"exo_knee": KNEE, "exo_hip": HIP})
    angles, rates = STATE[None, :2], STATE[None, 2:]
    joints = ("exo_knee", "exo_hip")
    found = design.torques(joints, TODAY[None], angles, rates, np.zeros(1))
    np.testing.assert_allclose(found[0], BOTH)
    context, port = asked(GainController([KNEE, HIP]))
    np.testing.assert_allclose(port.Eval(context), BOTH)


def test_nothing_is_changed_by_the_gains_of_today():
    context, port = asked(GainController([Gains(), Gains()]))
    np.testing.assert_array_equal(port.Eval(context), TODAY)
    same = Gains().torque(TODAY, STATE[:2], STATE[2:], 0.3)
    np.testing.assert_array_equal(same, TODAY)


def test_alone_it_is_a_spring_and_a_damper():
    """As `predict --controller` has it: nothing comes from another one."""
    context, port = asked(GainController([KNEE, HIP]), today=None)
    support = np.array([KNEE.support, HIP.support])
    np.testing.assert_allclose(port.Eval(context), BOTH - support * TODAY)


def test_gains_are_parameters_of_every_scalar_type():
    """Changed in a context, and carried over to converted ones."""
    system = GainController([Gains(), Gains()])
    context, port = asked(system)
    for i, own in enumerate((KNEE, HIP)):
        context.get_mutable_numeric_parameter(i).SetFromVector(own.coefficients)
    np.testing.assert_allclose(port.Eval(context), BOTH)
    differentiable = system.ToAutoDiffXd()
    assert isinstance(differentiable, GainController_[AutoDiffXd])
    other, port = asked(
        differentiable,
        TODAY.astype(object) * AutoDiffXd(1.0),
        InitializeAutoDiff(STATE).ravel(),
    )
    other.SetTimeStateAndParametersFrom(context)
    slope = np.array([x.derivatives() for x in port.Eval(other)])
    expected = [[-6.0, 0.0, -0.4, 0.0], [0.0, 0.0, 0.0, -1.2]]
    np.testing.assert_allclose(slope, expected)
    symbolic = GainController_[Expression]([KNEE, HIP])
    x = MakeVectorVariable(4, "x")
    told = symbolic.CreateDefaultContext()
    symbolic.GetInputPort("exoskeleton_state").FixValue(
        told, [Expression(v) for v in x]
    )
    found = symbolic.GetOutputPort("exoskeleton_torques").Eval(told)
    values = dict(zip(x, STATE, strict=True))
    alone = [e.Evaluate(values) for e in found]
    support = np.array([KNEE.support, HIP.support])
    np.testing.assert_allclose(alone, BOTH - support * TODAY)


@pytest.mark.parametrize(
    "law",
    [
        KNEE,
        Assistance((0.0, 40.0, 80.0), (1.2, 0.9, 0.7)),
        Assistance((), (1.0, 0.8, 0.9, 1.1, 1.0), "movement"),
    ],
)
def test_torques_are_linear_in_their_coefficients(law):
    rng = np.random.default_rng(0)
    today, angle, rate = rng.standard_normal((3, 7))
    share = np.linspace(0.0, 1.0, 7)
    parts = law.parts(today, angle, rate, share)
    assert parts.shape == (7, len(law.coefficients))
    found = law.torque(today, angle, rate, share)
    np.testing.assert_allclose(found, (parts * law.coefficients).sum(axis=1))
