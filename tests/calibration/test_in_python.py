"""What somebody does in a notebook: programs added to, trials by hand."""

import os
import signal
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from undrawn import undrawn

import drake_exo as dx
from drake_exo.calibration.phases import FootGroundCalibration
from drake_exo.calibration.problem import solved
from drake_exo.calibration.results import read_calibration, read_model
from drake_exo.contact.parameters import Posterior
from drake_exo.errors import InputError
from drake_exo.files.output import checksum
from drake_exo.nlp import infeasibility

COARSE = dx.settings.Solver(nodes_per_second=20.0)


@pytest.fixture(scope="module")
def made():
    return dx.synthetic.rises_in_device(2, nodes_per_second=20)


@pytest.fixture
def posed(made):
    settings = dx.settings.PredictionSettings(solver=COARSE)
    return dx.PredictionProblem(
        made.model, made.trials[:1], made.contact, settings
    )


def _knee(posed):
    k = posed.tree.coordinates.index("exo_knee")
    return posed.movements[0].grid.q[10, k]


def _value(posed, found, variable):
    return found.values[posed.program.indices(np.array([variable]))][0]


@pytest.mark.slow
def test_groups_of_settings_may_be_dicts(made):
    noise = {"moment_nm": 3.0}
    given = dx.settings.PredictionSettings(noise=noise, solver=COARSE)
    study = dx.Study(made.model, made.trials, prediction=given)
    assert study.prediction.noise.moment_nm == 3.0
    stiff = {"nominal": 9e3, "lower": 5e2, "upper": 3e4}
    heel = dx.settings.SphereSettings({**stiff, "upper": 5.0e4, "lower": 1e4})
    thigh = dx.settings.BushingSettings(normal_n_m=stiff, slip_n=stiff)
    study.interaction = dx.InteractionSettings(thigh=thigh)
    assert study.interaction.thigh.normal_n_m == dx.settings.Range(**stiff)
    with pytest.raises(InputError, match="9000 is not within its bounds"):
        study.foot_ground = dx.FootGroundSettings(heel=heel)
    thigh = dx.settings.BushingSettings(slip_n=stiff | {"lower": 0.0})
    with pytest.raises(InputError, match="slip_n: lower bound 0 is not a"):
        study.interaction = dx.InteractionSettings(thigh=thigh)
    posed = dx.PredictionProblem(
        made.model, made.trials[:1], made.contact, given
    )
    assert posed.settings == study.prediction
    with pytest.raises(InputError, match=r"device is \{.*give a Device"):
        dx.Study(made.model, made.trials, device={"carries_itself": 1.0})


@pytest.mark.slow
def test_what_is_added_after_a_solve_counts_in_the_next(posed):
    first = posed.solve()
    knee, prog = _knee(posed), posed.program.prog
    at = _value(posed, first, knee) + 0.02
    added = prog.AddLinearConstraint(knee >= at)
    found = posed.solve()
    assert found.success
    assert _value(posed, found, knee) == pytest.approx(at, abs=1e-6)
    # Drake's own ways to change what is there leave as many constraints.
    added.evaluator().UpdateLowerBound([at + 0.01])
    found = posed.solve()
    assert _value(posed, found, knee) == pytest.approx(at + 0.01, abs=1e-6)
    prog.RemoveConstraint(added)
    prog.AddLinearConstraint(knee >= at + 0.005)
    found = posed.solve()
    assert _value(posed, found, knee) == pytest.approx(at + 0.005, abs=1e-6)
    prog.AddCost(1e4 * (knee - at - 0.02) ** 2)
    assert _value(posed, posed.solve(), knee) > at + 0.01


@pytest.mark.slow
def test_a_variable_of_ones_own_starts_where_the_program_says(posed):
    prog = posed.program.prog
    near, nothing = prog.NewContinuousVariables(2, "own")
    prog.SetInitialGuess(near, 0.7)
    own = posed.program.indices(np.array([near, nothing]))
    assert posed.guess()[own].tolist() == [0.7, 0.0]


@pytest.mark.slow
def test_a_parameter_is_fixed_as_drake_fixes_it(made):
    settings = dx.settings.InteractionSettings(solver=COARSE)
    posed = dx.InteractionCalibration(
        made.model, made.trials, made.contact, settings
    )
    name = "thigh.normal_stiffness"
    variable = posed.variables_of([name])
    posed.program.prog.AddBoundingBoxConstraint(3000.0, 3000.0, variable)
    found = posed.solve()
    assert found.success
    known = {p.name: p.nominal for p in posed.parameters_at(found.values)}
    assert known[name] == pytest.approx(3000.0)


@pytest.mark.slow
def test_a_bound_that_is_added_to_the_program_is_told(made):
    settings = dx.settings.InteractionSettings(solver=COARSE)
    posed = dx.InteractionCalibration(
        made.model, made.trials, made.contact, settings
    )
    low, held = names = ["thigh.normal_stiffness", "shank.normal_stiffness"]
    prog = posed.program.prog
    prog.AddBoundingBoxConstraint(
        [100.0, 3000.0], [3000.0, 3000.0], posed.variables_of(names)
    )
    study = dx.Study(made.model, made.trials, interaction=settings)
    found = dx.Calibration("interaction", study, posed.solve())
    assert found.success
    assert found.parameter(low).upper == 3000.0
    assert found.parameter(low).free
    assert not found.parameter(held).free
    assert found.solution.active_bounds == [low]
    known = found.uncertainty()
    place = known.names.index(low)
    assert held not in known.names
    assert known.at_bound[place]
    assert not known.identifiable[place]
    assert f"{low} at a bound" in repr(known)
    rows = {p["name"]: p for p in found.summary()["parameters"]}
    assert rows[low]["at_bound"]
    assert "half_width_95" not in rows[low] or not rows[low]["half_width_95"]
    assert not rows[held]["free"]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda c: c.with_values({"tigh.slip": 0.1}), "no 'tigh.slip'"),
        (lambda c: c.with_values({"thigh.banana": 1.0}), "no 'thigh.banana'"),
        (lambda c: c.with_values({"thigh.normal_stiffness": -3.0}), "least 0"),
        (lambda c: c.fixed("waist"), "no 'waist'"),
        (lambda c: c.scaled(-1.0), "factor is -1"),
        (lambda c: c.scaled(np.nan), "factor is nan"),
    ],
)
def test_names_and_values_of_a_contact_are_its_own(made, call, words):
    with pytest.raises(InputError, match=words):
        call(made.contact)


def test_names_of_variables_are_those_of_the_contact(posed):
    with pytest.raises(InputError, match="is not a list of names"):
        posed.variables_of("thigh.slip")
    with pytest.raises(InputError, match="no 'slip'"):
        posed.variables_of(["slip"])
    with pytest.raises(InputError, match=r"did you mean 'thigh\.slip'"):
        posed.variables_of(["tigh.slip"])
    (trial,) = posed.trials
    with pytest.raises(InputError, match="did you mean 'pelvis'"):
        trial.cuff("plevis")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: replace(t, cuffs={"Thigh": t.cuffs["pelvis"]}), "'Thigh'"),
        (lambda t: replace(t, name="rise2"), "two trials are called 'rise2'"),
        (lambda t: replace(t, times=1e3 * t.times), "times in seconds"),
        (lambda t: replace(t, q=np.degrees(t.q)), "give q in radians"),
        (lambda t: t.sample(t.times[:2]), "2 samples"),
    ],
)
def test_trials_that_no_program_can_be_made_of_are_refused(made, change, words):
    trials = [change(made.trials[0]), made.trials[1]]
    with pytest.raises(InputError, match=words):
        dx.InteractionCalibration(made.model, trials, made.contact)


def test_a_grid_that_no_memory_holds_is_refused(made):
    fine = replace(COARSE, nodes_per_second=2e4)
    settings = dx.settings.InteractionSettings(solver=fine)
    with pytest.raises(InputError, match=r"20000 nodes_per_second over 1"):
        dx.InteractionCalibration(
            made.model, made.trials, made.contact, settings
        )


def test_no_movement_counts_twice(made):
    trial = made.trials[0]
    with pytest.raises(InputError, match="two trials are called 'rise1'"):
        dx.Study(made.model, [trial, trial])
    again = [*made.trials, replace(trial, name="again")]
    with pytest.raises(InputError, match="trials rise1 and again are the same"):
        dx.InteractionCalibration(made.model, again, made.contact)


@pytest.mark.parametrize("name", ["box/lift", ""])
def test_a_trial_has_a_name_for_its_files(made, name):
    study = dx.Study(made.model, made.trials)
    odd = replace(made.trials[0], name=name)
    for ask in (
        lambda: dx.Study(made.model, [odd]),
        lambda: dx.calibrate_foot_ground(study, [odd]),
        lambda: dx.predict(study, odd, made.contact),
    ):
        with pytest.raises(InputError, match="a trial's name is"):
            ask()


@pytest.mark.slow
def test_a_controller_of_the_device_alone_is_sent_to_predict(made):
    controller = dx.AssistController(knee_nm=10.0)
    with pytest.raises(InputError, match="AssistController, is for predict"):
        dx.build_diagram(made.model, made.contact, controller=controller)


PHASES = {
    "foot-ground": lambda m, trials, settings, **known: (
        dx.FootGroundCalibration(m.model, trials, settings, **known)
    ),
    "interaction": lambda m, trials, settings, contact=None: (
        dx.InteractionCalibration(
            m.model, trials, contact or m.contact, settings
        )
    ),
    "prediction": lambda m, trials, settings, contact=None: (
        dx.PredictionProblem(m.model, trials, contact or m.contact, settings)
    ),
}


@pytest.mark.parametrize("phase", PHASES)
def test_a_phase_is_posed_of_what_it_needs(made, phase):
    def words(trials=made.trials, settings=None, **known):
        with pytest.raises(InputError) as error:
            PHASES[phase](made, trials, settings, **known)
        return str(error.value)

    assert "is not a list of trials" in words(made.trials[0])
    assert "is not a list of trials" in words(None)
    assert "is not a trial" in words([made.model])
    assert "no trials" in words([])
    assert "settings is {}" in words(settings={})
    assert "give a" in words(settings=dx.settings.DesignSettings())
    known = {"ground": "flat"} if phase == "foot-ground" else {"contact": 3}
    assert "give a" in words(**known)


@pytest.mark.parametrize("phase", [*PHASES, "scene"])
def test_a_study_is_no_model(made, phase):
    study = dx.Study(made.model, made.trials)
    wrong = SimpleNamespace(model=study, contact=made.contact)
    with pytest.raises(InputError, match=r"model is Study.*; give a Model"):
        if phase == "scene":
            dx.Scene(study)
        else:
            PHASES[phase](wrong, made.trials, None)


def test_names_are_no_parameters(made):
    with pytest.raises(InputError, match="give a ContactParameter"):
        FootGroundCalibration(
            made.model, made.trials, parameters=["heel.stiffness"]
        )


def test_a_phases_settings_are_held_to_what_a_file_may_say(made):
    never = dx.settings.Solver(nodes_per_second=-3.0)
    settings = dx.settings.PredictionSettings(solver=never)
    with pytest.raises(InputError, match=r"settings.*nodes_per_second"):
        dx.PredictionProblem(made.model, made.trials, made.contact, settings)


def test_trials_of_the_same_samples_can_be_compared(made):
    trial = made.trials[0]
    again = replace(trial, q=trial.q.copy(), v=trial.v.copy())
    assert trial == trial and trial != again
    assert len({trial, again}) == 2
    assert trial.ground != replace(trial.ground, force=trial.ground.force + 0)


@pytest.mark.slow
def test_what_is_written_is_of_the_model_that_was_calibrated(tmp_path):
    """Whatever the study's is by now."""
    model, trials = dx.synthetic.rises_on_spheres(1, nodes_per_second=20)
    settings = dx.settings.FootGroundSettings(solver=COARSE)
    study = dx.Study(model, trials, foot_ground=settings)
    found = dx.calibrate_foot_ground(study)
    pelvis = model.human.pelvis
    heavy = replace(pelvis, mass_kg=pelvis.mass_kg + 20.0)
    study.model = replace(model, human=replace(model.human, pelvis=heavy))
    vars(found)["_audits"] = ()  # it need not simulate
    with undrawn():
        found.write(tmp_path)
    assert read_model(tmp_path) == model
    assert read_calibration(tmp_path).origin.model == checksum(model)


@pytest.mark.slow
def test_foot_and_ground_may_be_known():
    """By a contact or by no parameters; trials may come one by one."""
    model, trials = dx.synthetic.rises_on_spheres(2, nodes_per_second=20)
    usual = FootGroundCalibration(model, trials)
    ground = usual.contact.ground
    for how in ({"parameters": []}, {"ground": ground}):
        posed = FootGroundCalibration(model, iter(trials), **how)
        assert posed.parameters == [] and len(posed.trials) == 2
        assert posed.contact == usual.contact
    assert usual.parameters


@pytest.mark.slow
def test_phase_b_knows_nothing_of_a_calibration_before_it(made):
    """What was known is not of the values that a failed one ends with."""
    name = "thigh.normal_stiffness"
    known = Posterior((name,), np.array([7e3]), np.array([[1e4]]))
    posed = dx.InteractionCalibration(
        made.model, made.trials, replace(made.contact, posterior=known)
    )
    assert posed.contact.posterior is None


def test_nothing_is_started_near_what_is_no_solution(posed):
    with pytest.raises(InputError, match="near is 3"):
        posed.solve(near=3)


@pytest.mark.slow
def test_a_solution_is_solved_further_whatever_a_parameter_tells_there(
    monkeypatch,
):
    """At a start that is a fault; a solve may lead to where it moves none."""
    model, trials = dx.synthetic.rises_on_spheres(1, nodes_per_second=20)
    settings = dx.settings.FootGroundSettings(solver=COARSE)
    posed = FootGroundCalibration(model, trials, settings)
    found = posed.solve()
    monkeypatch.setattr(
        infeasibility, "_influence", lambda problem, y: np.zeros(len(y))
    )
    with pytest.raises(InputError, match="influences nothing"):
        posed.solve()
    assert posed.solve(near=found).success


def test_a_design_needs_a_study():
    with pytest.raises(InputError, match="no studies"):
        dx.design([], [])


def test_a_trials_feet_and_segments_are_the_models(made):
    trial = made.trials[0]

    def words(**changes):
        with pytest.raises(InputError) as error:
            dx.FootGroundCalibration(made.model, [replace(trial, **changes)])
        return str(error.value)

    sides = dict.fromkeys(("left", "right"), trial.ground)
    assert "no foot 'left'" in words(feet=sides)
    assert "no segment 'banana'" in words(applied={"banana": trial.ground})


@pytest.mark.parametrize("factor", [0.0, np.rad2deg(1.0)])
def test_velocities_are_those_of_the_motion(made, factor):
    trial = made.trials[0]
    wrong = replace(trial, v=factor * trial.v)
    said = r"rise1: v is not the derivative of q: (exo_)?(knee|hip) is"
    with pytest.raises(InputError, match=said):
        dx.FootGroundCalibration(made.model, [wrong])


@pytest.mark.slow
def test_what_a_callback_raises_ends_the_solve(posed):
    told = []

    def tell(iterate):
        told.append(iterate.iteration)
        if len(told) == 3:
            raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        posed.solve(on_iterate=tell)
    assert told == [0, 1, 2]


@pytest.mark.slow
def test_a_stopped_solve_is_no_mistake_of_the_input(posed):
    """Where nothing can go on without it, it is Ctrl-C that is told."""

    def stop(iterate):
        os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        solved(posed, "it does not fit", stop)
    knee = _knee(posed)
    posed.program.prog.AddBoundingBoxConstraint(50.0, 51.0, knee)
    with pytest.raises(dx.InputError, match=r"it does not fit \("):
        solved(posed, "it does not fit")
