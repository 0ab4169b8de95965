import re
from dataclasses import replace
from pathlib import Path

import pytest

import drake_exo as dx
from drake_exo.cli import main
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.study import StudyFile, read_study

STUDY = Path(__file__).parent / "studies" / "opencap_sts1.yaml"


def refusal(old, new, tmp_path) -> str:
    text = STUDY.read_text()
    assert old in text
    path = tmp_path / "study.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_study(path)
    assert str(caught.value).startswith(f"{path}:")
    return str(caught.value)


def test_reads_the_real_study(tmp_path):
    study = read_study(STUDY)
    assert study.root == STUDY.parent
    file = study.file
    assert [t.name for t in file.trials] == ["rise1", "rise2", "rise3"]
    assert file.markers.segments.pelvis.middle == ("C7",)
    assert (study.name, study.filter) == (file.subject.name, file.filter)
    elsewhere = read_study(STUDY, tmp_path)
    assert (elsewhere.file, elsewhere.root) == (file, tmp_path)


def test_a_use_without_trials_is_told_of_the_file():
    words = f"{STUDY}: no trial is for prediction"
    with pytest.raises(InputError, match=re.escape(words)):
        read_study(STUDY).trials("prediction")


def test_study_survives_writing():
    file = read_study(STUDY).file
    assert schema.load_text(schema.dump_text(file), StudyFile) == file


def test_data_root_must_be_a_folder(tmp_path):
    with pytest.raises(InputError, match=r"data_root \(--data-root\)"):
        read_study(STUDY, tmp_path / "none")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mass_kg: 60.0", "mass_kg: -60.0", "7: subject.mass_kg is -60.0"),
        ("mass_kg: 60.0", "mass_kg: 0.06", "7: subject.mass_kg is 0.06, but"),
        ("height_m: 1.70", "height_m: 0.17", "6: subject.height_m is 0.17"),
        ("  height_m:", "  heigth_m:", "did you mean 'height_m'"),
        ("order: 4", "order: 3", "two passes make it even"),
        ("{left: 2, right: 1}", "{left: 1, right: 1}", "'both: 1'"),
        ("{left: 2, right: 1}", "{left: 2, both: 1}", "name the plates"),
        ("name: rise2", "name: rise1", "37: trials: two are named 'rise1'"),
        (
            "name: rise2",
            "name: quality",
            "trials[1].name is 'quality', a name that a",
        ),
        (
            "name: rise2",
            "name: Summary",
            "trials[1].name is 'Summary', a name that a",
        ),
        ("rise: 1", "start_s: 2\n    end_s: 1", "end_s (1) must be after"),
        ("model: human", "model: humn", "did you mean 'human'"),
        (
            "{estimate_force_delay: true}",
            "{marker_axes: {forward: x, up: -x}}",
            "two different axes",
        ),
        ("rise: 1", "rise: 0", "at least 1"),
        ("  prior", "  spheres: {hel: {}}\n  prior", "did you mean 'heel'"),
        ("  prior", "  front: [0.5, 0]\n  prior", "must be above 0"),
        ("  prior", "  end_tolerance: {velocity_m_s: -1}\n  prior", "least 0"),
        (
            "  solver: {",
            "  solver: {max_iterations: 99999999999, ",
            "max_iterations is 99999999999, but must be at most 1e+09",
        ),
        (
            "foot_ground:",
            "prediction: {speed_m_s: 1.3}\nfoot_ground:",
            "prediction: speed_m_s is that of a step without data",
        ),
        (
            "foot_ground:",
            "prediction: {clearance_m: 0.03}\nfoot_ground:",
            "prediction: clearance_m is that of a step without data",
        ),
        (
            "foot_ground:",
            "prediction: {ends: periodic, objective: comfort}\nfoot_ground:",
            "prediction: objective is comfort, but a step without data",
        ),
        ("lower: 0.0,", "lower: -0.1,", "lower bound -0.1 is negative"),
        (
            "x_m: {below: 0.08,",
            "x_m: {below: 80,",
            "foot_ground.heel.x_m.below is 80, but must be at most 1 m",
        ),
        (
            "    modulus",
            "    radius_m: {nominal: 32, lower: 10, upper: 60}\n    modulus",
            "radius_m: upper bound is 60, but must be at most 1 m",
        ),
        (
            "\nfoot_ground:",
            "\ninteraction: {origin_sd_m: 15}\nfoot_ground:",
            "interaction.origin_sd_m is 15, but must be at most 1 m",
        ),
        (
            "\nfoot_ground:",
            "\ninteraction: {errors: {mat_clock_s: 30}}\nfoot_ground:",
            "interaction.errors.mat_clock_s is 30, but must be at most 1 s",
        ),
        (
            "\nfoot_ground:",
            "\nprediction: {errors: {mat_share: 5}}\nfoot_ground:",
            "prediction.errors.mat_share is 5, but must be at most 1",
        ),
        (
            "  prior",
            "  constants: {static_friction: 80}\n  prior",
            "static_friction is 80, but must be at most 10",
        ),
        (
            "  prior",
            "  constants: {static_friction: 0.5}\n  prior",
            "dynamic_friction 0.8 is above static_friction 0.5; give both",
        ),
        (
            "  prior",
            "  constants: {hertz_smoothing: 0.3}\n  prior",
            "constants.hertz_smoothing is 0.3, but must be at least 10 1/m",
        ),
        (
            "  prior",
            "  constants: {hunt_crossley_smoothing: 0.05}\n  prior",
            "hunt_crossley_smoothing is 0.05, but must be at least 1 s/m",
        ),
        (
            "  prior",
            "  constants: {transition_velocity: 50}\n  prior",
            "transition_velocity is 50, but must be at most 1 m/s",
        ),
        (
            "  prior",
            "  constants: {constant_contact_force: 1}\n  prior",
            "constant_contact_force is 1, but must be at most 0.01",
        ),
        (
            "upper: 1.0e7",
            "upper: 1.0e13",
            "modulus_n_m2: upper bound is 1e+13, but must be at most 1.2e+12",
        ),
        (
            "\nfoot_ground:",
            "\ninteraction: {errors: {friction: 40}}\nfoot_ground:",
            "interaction.errors.friction is 40, but must be at most 10",
        ),
        (
            "\nfoot_ground:",
            "\ninteraction: {errors: {skin: 3}}\nfoot_ground:",
            "interaction.errors.skin is 3, but must be at most 1 rad/rad",
        ),
        (
            "\nfoot_ground:",
            "\ninteraction: {errors: {encoder_offset_deg: 200}}\nfoot_ground:",
            "errors.encoder_offset_deg is 200, but must be at most 180 deg",
        ),
        (
            "model: human",
            "model: human\nground: {belt_speed_m_s: 1240}",
            "ground.belt_speed_m_s is 1240, but must be at most 15 m/s",
        ),
        (
            "model: human",
            "model: coupled\ndevice: {knee: {coulomb_speed_rad_s: 2.86}}",
            "knee.coulomb_speed_rad_s is 2.86, but must be at most 1 rad/s",
        ),
        (
            "model: human",
            "  segments: {ankle_height_m: 0.68}\nmodel: human",
            "subject.segments.ankle_height_m is 0.68, but must be at most 0.3",
        ),
        (
            "  solver: {",
            "  solver: {tolerance: 1.0e+5, ",
            "foot_ground.solver.tolerance is 1.0e+5, but must be at most 0.1",
        ),
        (
            "{estimate_force_delay: true}",
            "{fill_gaps_s: 200}",
            "laboratory.fill_gaps_s is 200, but must be at most 10 s",
        ),
        ("lower: 1.0e5,", "lower: 1.0,", "lower bound is 1, but must be at"),
        (
            "    modulus",
            "    radius_m: {nominal: 1, lower: 1.0e-5, upper: 1}\n    modulus",
            "radius_m: lower bound is 1e-05, but must be at least 0.001 m",
        ),
        (
            "x_m: {below: 0.08,",
            "x_m: {shift: -0.1, below: 0.08,",
            "foot_ground.heel.x_m: shift is -0.1 m, but its bounds are below",
        ),
        (
            "\nfoot_ground:",
            "\ninteraction: {thigh: {normal_n_m: {nominal: 0, lower: 0, "
            "upper: 9}}}\nfoot_ground:",
            "normal_n_m: nominal is 0",
        ),
        (
            "\nfoot_ground:",
            "\ninteraction: {thigh: {normal_n_m: {nominal: 5, lower: 0.1, "
            "upper: 50}}}\nfoot_ground:",
            "thigh: normal_n_m: nominal is 5, but must be at least 100 N/m",
        ),
        (
            "model: human",
            "model: {device: {weld: {exo_foot: foot}}, "
            "cuffs: {calf: {human: shank, device: exo_shank}}}\n"
            "interaction: {cuffs: {calv: {}}}",
            "interaction.cuffs: the model has no 'calv'; it has calf",
        ),
        (  # Else told after minutes of calibrating.
            "model: human",
            "model: {device: {weld: {exo_foot: foot}}, "
            "cuffs: {calf: {human: shank, device: exo_shank}}}\n"
            "design: {cuffs: {calv: {}}}",
            "design.cuffs: the model has no 'calv'; it has calf",
        ),
        (
            "model: human",
            "model: {device: {weld: {exo_foot: foot}}, "
            "cuffs: {calf: {human: shank, device: exo_shank}}}\n"
            "interaction: {shank: {slip_n: null}}",
            "interaction: the model has no 'shank'; it has calf",
        ),
        (
            "model: human",
            "model: {ground: {foot: [heel, ball]}}",
            "foot_ground: the model has no 'toe'; it has heel, ball",
        ),
        (
            "  prior",
            "  spheres: {toe: {}}\n  prior",
            "spheres: 'toe' is given by the key toe, too; keep one of them",
        ),
        (
            "model: human",
            "model: human\ninteraction: {thigh: {slip_n: null}, "
            "cuffs: {thigh: {}}}",
            "cuffs: 'thigh' is given by the key thigh, too",
        ),
        (
            "model: human",
            "model: {device: {file: a.urdf, weld: {a: foot}}}\n"
            "exoskeleton: {shank: {mass_kg: 2}}",
            "exoskeleton has values of the shipped device",
        ),
        (
            "model: human",
            "  segments: {thigh_cuff_m: [0.0, 0.2]}\n"
            "model: {device: {file: a.urdf, weld: {a: foot}}, cuffs: "
            "{up: {human: thigh, device: b, at_m: [0.0, 0.3]}}}",
            "subject.segments.thigh_cuff_m is used for no cuff",
        ),
        (
            "model: human",
            "model: human\ninteraction: {thigh: {normal_n_m: "
            "{nominal: 5, lower: 5, upper: 5}}}",
            "lower bound 5 is not below upper bound 5; correct them",
        ),
        (
            "model: human",
            "model: {device: {weld: {exo_foot: foot}, fixed: [exo_knee]}}",
            "fixed, forward and upright_deg belong to a device's file",
        ),
        (
            "model: human",
            "model: {ground: {foot: {heel: [-50, -60], toe: [0.1, -0.06]}}}",
            "model.ground.foot.heel[0] is -50, but must be at least -3 m",
        ),
        (
            "model: human",
            "  segments: {toe_m: [0.1, -0.05]}\nmodel: coupled",
            "subject.segments.toe_m places a sphere on the foot",
        ),
        (
            "model: human",
            "model: {human: {legs: two}}\ndevice: {moment_legs: left}",
            "device.moment_legs is 'left', which takes one leg for both",
        ),
    ],
)
def test_refuses(old, new, words, tmp_path):
    assert words in refusal(old, new, tmp_path)


@pytest.mark.parametrize(
    ("section", "law", "words"),
    [
        ("{law: nowhere.yaml}", None, "nowhere.yaml: cannot be read"),
        ("{law: simbdy}", None, "simbody, paper or a .yaml"),
        ("{law: }", None, "one of simbody, paper, but is empty"),
        ("{law: law.yaml, prior_weight: -1}", None, "prior_weight"),
        ("{law: law.yaml, constants: {static_friction: 1}}", None, "constants"),
        ("{sole_at_m: [0, 0]}", None, "sole_at_m"),
        ("{law: law.yaml}", "size_m: [0.3, 0.1, 0.0]", "above 0"),
        ("{law: law.yaml}", "size_m: [0.3, 0.1, 0.03]", "'spheres'"),
        (
            "{law: law.yaml}",
            "size_m: [0.3, 0.1, 0.03]\nspheres: {a: {modulus_n_m2: 1e7}}",
            "--spheres 2",
        ),
        ("{law: law.yaml}", "spheres: [", "not valid YAML"),
    ],
)
def test_a_law_that_is_none_is_refused(section, law, words, tmp_path, capsys):
    path = tmp_path / "study.yaml"
    head, _, _ = STUDY.read_text("utf-8").partition("\nfoot_ground:")
    path.write_text(head + f"\nfoot_ground: {section}\n", encoding="utf-8")
    if law is not None:
        (tmp_path / "law.yaml").write_text(law, encoding="utf-8")
    assert main(["check", str(path)]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_what_is_no_study_is_told():
    for function, others in (
        (dx.calibrate_foot_ground, []),
        (dx.calibrate_interaction, [[], None]),
        (dx.predict, [[], None]),
    ):
        with pytest.raises(InputError, match=r"study is 'a\.yaml'; give"):
            function("a.yaml", *others)


@pytest.mark.slow
def test_what_a_study_does_not_have_is_not_set():
    """Misspelt, it was kept and never read."""
    made = dx.synthetic.rises_in_device(1, nodes_per_second=40)
    study = dx.Study(made.model, made.trials)
    with pytest.raises(AttributeError, match=r"'predicton' .* 'prediction'"):
        study.predicton = study.prediction
    with pytest.raises(AttributeError, match="no 'solver_tolerance' to set"):
        study.solver_tolerance = 1
    with pytest.raises(AttributeError, match=r"no 'trials' to set$"):
        study.trials = made.trials  # nor does it want 'reads'
    with pytest.raises(InputError, match=r"prediction is .*PredictionSettings"):
        study.prediction = study.interaction
    study.prediction = changed = replace(study.prediction, torque_limit_nm=90.0)
    assert study.prediction == changed


@pytest.mark.slow
def test_a_study_in_python_is_checked_as_its_file():
    model, trials = dx.synthetic.rises_on_spheres(1, nodes_per_second=40)
    sphere = dx.settings.SphereSettings()
    for words, wrong in (
        ("has no 'heal'; it has heel", {"spheres": {"heal": sphere}}),
        ("'simbody' has no 'friction'", {"constants": {"friction": 1.0}}),
        (
            "law is 'sole.yaml', the law of a sole that",
            {"law": Path("sole.yaml")},
        ),
    ):
        settings = dx.FootGroundSettings(**wrong)
        with pytest.raises(InputError, match=words):
            dx.Study(model, trials, foot_ground=settings)
    study = dx.Study(model, trials)
    for name in ("name", "model", "device", "sole"):
        with pytest.raises(InputError, match=f"{name} is 1.5; give a "):
            setattr(study, name, 1.5)


def test_what_recordings_were_read_with_is_the_files():
    """Set afterwards, it would be told of trials that had another."""
    study = dx.read_study(STUDY)
    for name in ("filter", "device", "model", "file", "root"):
        with pytest.raises(AttributeError, match=f"study file's {name}"):
            setattr(study, name, None)
    assert study.filter == study.file.filter
