"""Parameters of the force systems: contexts, scalar types, bad values."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from force_models import (
    coupled,
    random_state,
    unusual_bushings,
    unusual_ground,
)
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue
from pydrake.symbolic import Evaluate, Expression, MakeVectorVariable

from drake_exo.contact import strap, systems
from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.hunt_crossley import PaperConstants
from drake_exo.contact.parameters import ContactSphere, nominal_contact
from drake_exo.contact.systems import (
    FootGroundContact,
    HumanExoskeletonBushings,
)
from drake_exo.errors import InputError
from drake_exo.model.plant import nominal_model

LAWS = ("paper", "simbody")


def changed(parameters):
    """Other values than those of the construction, for a context."""
    constants = type(parameters.constants)(
        *(1.1 * np.array(astuple(parameters.constants)))
    )
    spheres = {
        name: ContactSphere(*(0.9 * np.array(astuple(sphere))))
        for name, sphere in parameters.spheres.items()
    }
    return replace(parameters, spheres=spheres, constants=constants)


def port_values(model, context, diagram=None):
    """All force outputs as one vector."""
    diagram = diagram or model.diagram
    return np.concatenate(
        [
            diagram.GetOutputPort(name).Eval(context)
            for name in (
                "ground_reaction",
                "sphere_wrenches",
                "interaction_forces",
                "deflections",
                "energies",
            )
        ]
    )


def converted(model, T):
    if T is AutoDiffXd:
        return model.diagram.ToAutoDiffXd(), ExtractValue
    return model.diagram.ToSymbolic(), Evaluate


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("T", [AutoDiffXd, Expression])
def test_values_of_the_construction_survive_conversion(law, T):
    model = coupled(law)
    context = random_state(model, 7)
    diagram, to_float = converted(model, T)
    other = diagram.CreateDefaultContext()
    # Only the state is handed over: the parameters are the default ones of
    # the converted systems.
    other.get_mutable_continuous_state_vector().SetFromVector(
        context.get_continuous_state_vector().CopyToVector()
    )
    np.testing.assert_allclose(
        to_float(port_values(model, other, diagram)).ravel(),
        port_values(model, context),
        rtol=1e-9,
        atol=1e-12,
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("T", [AutoDiffXd, Expression])
def test_values_of_the_context_survive_conversion(law, T):
    model = coupled(law)
    context = random_state(model, 8)
    before = port_values(model, context)
    contact = changed(unusual_ground(law))
    bushings = {n: b.scaled(1.4) for n, b in unusual_bushings().items()}
    contact_context = model.contact.GetMyMutableContextFromRoot(context)
    bushing_context = model.bushings.GetMyMutableContextFromRoot(context)
    model.contact.set_parameters(contact_context, contact)
    model.bushings.set_parameters(bushing_context, bushings)
    assert model.contact.parameters(contact_context) == contact
    assert model.bushings.parameters(bushing_context) == bushings
    assert model.contact.parameters() == unusual_ground(law)
    assert model.bushings.parameters() == unusual_bushings()
    after = port_values(model, context)
    energies = slice(-9, None)
    np.testing.assert_allclose(after[energies], 1.4 * before[energies])
    assert abs(after[1] / before[1] - 1.0) > 0.02
    diagram, to_float = converted(model, T)
    other = diagram.CreateDefaultContext()
    other.SetTimeStateAndParametersFrom(context)
    np.testing.assert_allclose(
        to_float(port_values(model, other, diagram)).ravel(),
        after,
        rtol=1e-9,
        atol=1e-12,
    )


@pytest.mark.parametrize("law", LAWS)
def test_autodiff_differentiates_by_state_and_parameter(law):
    model = coupled(law)
    context = random_state(model, 9)
    diagram = model.diagram.ToAutoDiffXd()
    other = diagram.CreateDefaultContext()
    other.SetTimeStateAndParametersFrom(context)
    state = context.get_continuous_state_vector().CopyToVector()
    contact = next(
        s for s in diagram.GetSystems() if s.get_name() == "foot_ground_contact"
    )
    heel = contact.GetMyMutableContextFromRoot(
        other
    ).get_mutable_numeric_parameter(0)
    values = heel.CopyToVector()
    other.get_mutable_continuous_state_vector().SetFromVector(
        np.array([AutoDiffXd(v, np.eye(21)[i]) for i, v in enumerate(state)])
    )
    # Stiffness and location of the heel's sphere.
    for column, i in ((18, 0), (19, 2), (20, 3)):
        heel.SetAtIndex(i, AutoDiffXd(values[i].value(), np.eye(21)[column]))
    gradient = ExtractGradient(
        diagram.GetOutputPort("ground_reaction").Eval(other).reshape(-1, 1)
    )
    assert gradient.shape == (3, 21)

    def reaction(x, sphere):
        changed = model.diagram.CreateDefaultContext()
        changed.SetTimeStateAndParametersFrom(context)
        changed.get_mutable_continuous_state_vector().SetFromVector(x)
        model.contact.GetMyMutableContextFromRoot(
            changed
        ).get_mutable_numeric_parameter(0).SetFromVector(sphere)
        return model.diagram.GetOutputPort("ground_reaction").Eval(changed)

    heel_values = np.array([v.value() for v in values])
    for column in range(21):
        steps = []
        for sign in (1.0, -1.0):
            x, sphere = state.copy(), heel_values.copy()
            if column < 18:
                step = 1e-6
                x[column] += sign * step
            else:
                i = (0, 2, 3)[column - 18]
                step = 1e-6 * abs(sphere[i])
                sphere[i] += sign * step
            steps.append(reaction(x, sphere))
        difference = (steps[0] - steps[1]) / (2.0 * step)
        scale = np.max(np.abs(difference)) + 1e-3
        np.testing.assert_allclose(
            gradient[:, column], difference, atol=1e-5 * scale
        )


def test_forces_are_expressions_of_the_state():
    model = coupled("paper")
    context = random_state(model, 10)
    diagram = model.diagram.ToSymbolic()
    other = diagram.CreateDefaultContext()
    variables = MakeVectorVariable(18, "x")
    other.get_mutable_continuous_state_vector().SetFromVector(
        np.array([Expression(v) for v in variables])
    )
    expressions = diagram.GetOutputPort("interaction_forces").Eval(other)
    state = context.get_continuous_state_vector().CopyToVector()
    environment = dict(zip(variables, state, strict=True))
    np.testing.assert_allclose(
        Evaluate(expressions, environment).ravel(),
        model.diagram.GetOutputPort("interaction_forces").Eval(context),
        rtol=1e-9,
    )


def test_bad_parameters_are_refused():
    body = nominal_model("human").plant().GetBodyByName("foot").index()
    good = nominal_contact(nominal_model("human"), "paper").ground
    heel = good.spheres["heel"]
    for field, value, message in (
        ("stiffness", 0.0, "'heel': stiffness is 0, but must be above"),
        ("dissipation", -1.0, "must be at least 0"),
        ("radius", np.nan, "must be a finite number"),
    ):
        spheres = {**good.spheres, "heel": replace(heel, **{field: value})}
        with pytest.raises(InputError, match=message):
            FootGroundContact(body, replace(good, spheres=spheres))
    with pytest.raises(InputError, match="transition_velocity is 0"):
        FootGroundContact(
            body,
            replace(good, constants=PaperConstants(transition_velocity=0.0)),
        )
    with pytest.raises(InputError, match="needs a sphere"):
        FootGroundContact(body, replace(good, spheres={}))
    system = FootGroundContact(body, good)
    context = system.CreateDefaultContext()
    with pytest.raises(InputError, match="dissipation is -1"):
        below = replace(heel, dissipation=-1.0)
        spheres = dict.fromkeys(good.spheres, below)
        system.set_parameters(context, replace(good, spheres=spheres))
    # Constants that are left out are the law's, not this system's.
    slippery = PaperConstants(transition_velocity=0.3)
    other = FootGroundContact(body, replace(good, constants=slippery))
    context = other.CreateDefaultContext()
    other.set_parameters(context, replace(good, constants=None))
    assert other.parameters(context).constants == PaperConstants()
    with pytest.raises(InputError, match="law 'paper' and the spheres heel"):
        system.set_parameters(
            system.CreateDefaultContext(),
            replace(good, spheres={"heel": heel}),
        )
    with pytest.raises(InputError, match="normal_damping is -1"):
        HumanExoskeletonBushings(
            {"shank": (body, body)},
            {"shank": BushingParameters(normal_damping=-1.0)},
        )
    usual = {"shank": BushingParameters()}
    cuffs = HumanExoskeletonBushings({"shank": (body, body)}, usual)
    context = cuffs.CreateDefaultContext()
    with pytest.raises(InputError, match="'shank': slip is nan, but must be"):
        cuffs.set_parameters(context, {"shank": BushingParameters(slip=np.nan)})
    assert cuffs.parameters(context) == usual
    with pytest.raises(InputError, match="name the same"):
        HumanExoskeletonBushings({"shank": (body, body)}, {})


def test_default_systems_are_made_as_they_are_asked_for():
    """Each takes Drake a tenth of a second, in every command's start."""
    for module, name in (
        (systems, "FootGroundContact"), (strap, "GainController"),
    ):  # fmt: skip
        template = getattr(module, f"{name}_")
        assert name not in vars(module)
        assert getattr(module, name) is template[float]
        with pytest.raises(AttributeError, match="has no attribute 'Chairs'"):
            _ = module.Chairs
