"""`dx.design` and the command: forecast, files, verdict, refusals."""

import json
import os
import re
import signal
from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import worn
from page_reader import player_data
from unmarked import unmarked

import drake_exo as dx
from drake_exo import designing
from drake_exo.calibration.clocks import Clock, retimed
from drake_exo.calibration.design import DesignProblem
from drake_exo.calibration.design_variables import Variable
from drake_exo.calibration.error_model import NO_ERRORS
from drake_exo.calibration.settings import (
    CuffFreedom,
    DesignLimits,
    DesignSettings,
    DriveLimits,
    Population,
    PredictionSettings,
    Solver,
)
from drake_exo.calibration.wearers import Hold, Wearer
from drake_exo.cli import main
from drake_exo.cli.design import without_effect
from drake_exo.contact.parameters import Posterior, nominal_contact
from drake_exo.contact.strap import CuffDesign, Design, read_design
from drake_exo.designed import Designed, Moved, Peak
from drake_exo.designing import on_design, pareto_front
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.files.output import Check, Verdict
from drake_exo.measurement.settings import Device, JointDrive
from drake_exo.measurement.trial import CuffForce
from drake_exo.model.plant import nominal_model
from drake_exo.report.figures import forces_figure
from drake_exo.virtual_laboratory import synthetic

SOLVER = Solver(20.0, tolerance=1e-4)
SETTINGS = DesignSettings(draws=0, points=1, solver=SOLVER)


@pytest.fixture(scope="module")
def study():
    """Two rises with a device that bears a part of it."""
    made = dx.synthetic.rises_in_device(2, nodes_per_second=25.0)
    trials = []
    for trial in made.trials:
        names, moments = trial.coordinates, trial.moments.copy()
        s = np.sin(np.pi * trial.times / trial.duration) ** 2
        for joint, nm in (("exo_knee", -20.0), ("exo_hip", -12.0)):
            moments[:, names.joint(joint)] += nm * s
            moments[:, names.joint(names.follows(joint))] -= nm * s
        trials.append(replace(trial, moments=moments))
    prediction = PredictionSettings(errors=NO_ERRORS)
    own = dx.Study(made.model, trials, prediction=prediction, design=SETTINGS)
    return own, made.contact


@pytest.fixture(scope="module")
def found(study):
    return dx.design(*study, parts=True)


def test_settings_that_a_model_cannot_have_are_told_with_their_file():
    made = dx.synthetic.rises_in_device(1, nodes_per_second=20.0)
    drives = {"exo_neck": DriveLimits(torque_nm=40.0)}
    wrong = DesignSettings(limits=DesignLimits(drives=drives))
    own = dx.Study(made.model, made.trials, design=wrong)
    told = "design.limits.drives.exo_neck: the device has no such joint"
    with pytest.raises(InputError, match=f"^{told}"):
        dx.design(own, made.contact)
    own.path = "wearer.yaml"
    with pytest.raises(InputError, match=f"^wearer.yaml: {told}"):
        dx.design(own, made.contact)


@pytest.mark.slow
def test_a_design_holds_and_tells_what_it_buys(found):
    assert found.success
    verdict = found.verdict()
    assert verdict.word == "holds", verdict.text()
    norms = found.summary()["norm_n"]
    assert norms["after"] < 0.9 * norms["before"]
    assert norms["forecast"] == pytest.approx(norms["after"], rel=6e-3)
    support = found.support
    assert support["after"] == pytest.approx(support["before"], rel=0.03)
    parts = found.parts
    assert set(parts) > {"nothing", "all"}
    assert parts["all"] < 0.9 * parts["nothing"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", designing._KINDS)
def test_no_kind_of_variable_alone_costs_less_than_all(found, kind):
    """Its norm may be less: migration beyond its limit costs, too."""
    alone = designing._alone(found, kind)
    assert alone.solution.success
    assert alone.norm_n == pytest.approx(found.parts[f"{kind} alone"])
    assert alone.solution.objective > found.found.solution.objective


@pytest.mark.slow
def test_a_design_stays_where_its_parts_are_stopped(found, monkeypatch):
    class Stopping(designing.SolveWatch):
        def __call__(self, iterate):
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(designing, "SolveWatch", Stopping)
    made = designing._with_parts(found)
    assert made.success and made.stopped and not found.stopped
    assert list(made.parts) == ["nothing", "all"]


def test_a_design_stays_where_it_is_interrupted_between_parts(monkeypatch):
    def interrupted(made, kind):
        raise KeyboardInterrupt

    monkeypatch.setattr(designing, "_alone", interrupted)
    free = [Variable("thigh.along_m", "m", -0.1, 0.1, 0.0, 0.01)]
    problem = SimpleNamespace(without=(), design=free)
    own = SimpleNamespace(norm_n=2.0, problem=problem)
    found = Designed(DesignSettings(), own, own, {}, {})
    made = designing._with_parts(found)
    assert made.stopped and made.parts == {"nothing": 2.0, "all": 2.0}


@pytest.mark.parametrize(
    ("cls", "text", "words"),
    [
        (Design, "cuffs: {thigh: {along_m: 20}}", "along_m is 20"),
        (Design, "joints: {exo_knee: {across_m: -9}}", "across_m is -9"),
        (DesignSettings, "joints: {exo_knee: {along_m: [0, 5]}}", "1] is 5"),
    ],
)
def test_shifts_in_millimetres_are_told_with_their_line(cls, text, words):
    """Only the device that was made with them was refused."""
    with pytest.raises(InputError, match=f"<text>:1: .*{words}, .*1 m"):
        schema.load_text(text, cls)


def test_what_cannot_change_is_no_part(monkeypatch):
    """Such as the torques of a device that nothing drives."""
    monkeypatch.setattr(
        designing,
        "_alone",
        lambda made, kind: SimpleNamespace(
            norm_n=3.0,
            solution=SimpleNamespace(was_stopped=False, success=True),
        ),
    )
    variables = [
        Variable("thigh.along_m", "m", 0.0, 0.0, 0.0, 0.01),
        Variable("thigh.strap_normal_n_m", "m/N", 0.0, 1e-3, 0.0, 1e-4),
        Variable("exo_knee.along_m", "m", 0.0, 0.0, 0.0, 0.01),
    ]
    problem = SimpleNamespace(without=(), design=variables)
    own = SimpleNamespace(norm_n=4.0, problem=problem)
    made = designing._with_parts(Designed(DesignSettings(), own, own, {}, {}))
    assert list(made.parts) == ["nothing", "straps alone", "all"]


@pytest.mark.slow
def test_the_mark_is_on_everything_that_is_written(
    found, tmp_path, monkeypatch
):
    off = Verdict((Check("audit", False, 2.0, 1.0, "N", "rise1"),))
    monkeypatch.setattr(type(found), "verdict", lambda *_: off)
    found.write(tmp_path)
    assert unmarked(tmp_path) == []
    assert list(tmp_path.glob("*.png")) and list(tmp_path.glob("*.txt"))


@pytest.mark.slow
def test_peaks_are_means_over_trials_that_have_mats(found, study):
    own, _ = study
    for cuff, peak in found.peaks.items():
        seen = [
            np.abs(t.cuffs[cuff].normal).max()
            for t in own.trials()
            if cuff in t.cuffs
        ]
        if not seen:
            assert peak.measured_before is None
            assert peak.forecast_after == peak.model_after
            continue
        assert peak.measured_before == pytest.approx(np.mean(seen))
        ratio = peak.forecast_after / peak.model_after
        expected = peak.measured_before / peak.model_before
        assert ratio == pytest.approx(expected)
        assert peak.forecast_low <= peak.forecast_after <= peak.forecast_high


@pytest.mark.slow
def test_what_is_felt_is_what_mats_would_show(found):
    """The largest of a trial, so no less than the mean over trials."""
    (moved,) = found.before.values()
    differ = found.first[0].differ
    assert set(differ) and any(abs(x - 1.0) > 0.05 for x in differ.values())
    for row in found.felt():
        cuff = row["cuff"]
        own = [np.abs(m.trial.cuffs[cuff].normal).max() for m in moved]
        expected = differ.get(cuff, 1.0) * max(own)
        assert row["before"]["peak_n"] == pytest.approx(expected)
        pressure = 1e-3 * expected / SETTINGS.freedom(cuff).area_m2
        assert row["before"]["pressure_kpa"] == pytest.approx(pressure)
        shear = [np.abs(m.trial.cuffs[cuff].tangential).max() for m in moved]
        assert row["before"]["shear_n"] == pytest.approx(max(shear))


@pytest.mark.slow
def test_migration_as_built_is_what_encoders_tell(found, study, tmp_path):
    """Of trials that are the very forecast; others have no such row."""
    ((name, after),) = found.after.items()
    assert {r["measured_migration_mm"] for r in found.felt()} == {None}
    trials = [
        replace(m.trial, provenance={"encoders": "angles.csv"}) for m in after
    ]
    made = designing.built(found, study[0], {name: trials})
    assert list(made.measured) == list(made.seen) == [name]
    wearer, _ = found.first
    for row in made.felt():
        model = row["after"]["migration_mm"] / wearer.slides(row["cuff"])
        assert row["measured_migration_mm"] == pytest.approx(model, rel=6e-4)
    made.write(tmp_path)
    assert "shank built" in (tmp_path / "design.txt").read_text()
    unseen = designing.built(found, study[0], {name: [after[0].trial]})
    assert unseen.seen == {}


@pytest.mark.slow
def test_files(found, study, tmp_path):
    verdict = found.write(tmp_path)
    assert verdict.exit_code == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["verdict"] == "holds"
    assert set(summary["peaks_n"]) == {"shank", "thigh", "pelvis"}
    assert set(summary["peaks_n"]["thigh"]) == set(Peak.__dataclass_fields__)
    assert {"before", "after"} <= set(summary["support"])
    assert read_design(tmp_path) == found.design
    contact = dx.read_contact(tmp_path, accept=["provenance"])
    built = found.design.contact(study[1])
    assert contact.values() == pytest.approx(built.values())
    names = {row["name"] for row in summary["variables"]}
    assert {"thigh.along_m", "exo_knee.factor_at_0_deg"} <= names
    text = (tmp_path / "design.txt").read_text()
    assert "thigh.along_m" in text and "N" in text
    for name in ("forces.png", "device.png"):
        assert (tmp_path / name).stat().st_size > 10_000
    own = nominal_model("coupled").exoskeleton
    sdf = ElementTree.parse(tmp_path / "device.sdf")
    for cuff, moved in found.design.cuffs.items():
        pose = sdf.find(f".//frame[@name='exo_{cuff}_cuff']/pose").text
        x, _, z = map(float, pose.split()[:3])
        place = np.add(own.cuff_m(cuff), (moved.across_m, moved.along_m))
        assert (x, z) == pytest.approx(tuple(place), abs=1e-6)
    work = summary["support"]["before"]
    own = sum(m.trial.device_work for ms in found.before.values() for m in ms)
    assert work == pytest.approx(own)


@pytest.mark.slow
def test_a_design_is_replayed_beside_the_device_of_today(found, tmp_path):
    """Cuffs where they are built, and where they are; each with its force."""
    found.write(tmp_path / "designed")
    page = tmp_path / "page.html"
    assert main(["view", str(tmp_path / "designed"), "--out", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert "Today (blue, translucent)" in text
    assert "EXTRAPOLATED" in text
    clips = player_data(page)["clips"]
    name, (first, *_) = next(iter(found.after.items()))
    assert len(clips) == len(found.after[name])
    wearer, before = found.first
    contact = wearer.contact
    for moved, key, design in (
        (before[0], "thigh_measured", Design()),
        (first, "thigh", found.design),
    ):
        rows = clips[0]["arrows"][key].reshape(-1, 6)
        force = moved.trial.cuffs["thigh"]
        size = np.hypot(force.normal[0], force.tangential[0])
        assert np.hypot(*rows[0, [3, 5]]) == pytest.approx(size)
        cuff = design.contact(contact).bushings["thigh"]
        tree = design.model(wearer.model).tree
        place = np.add(cuff.origin, cuff.preload[:2])
        at = tree.point_positions(moved.trial.q[:1], "exo_thigh", place)[0]
        assert rows[0, [0, 2]] == pytest.approx(at, abs=1e-4)


@pytest.mark.slow
def test_what_would_hang_loose_as_built_is_no_design(study, monkeypatch):
    """However little its cuffs press; with every cuff the verdict tells it."""
    monkeypatch.setattr(Designed, "held", Hold(-5.2, "exo_knee"))
    own, contact = study
    limits = DesignLimits(
        migration_mm=None, moment_factor=None, effort_factor=None
    )
    free = {"shank": CuffFreedom(removable=True)}
    settings = replace(SETTINGS, limits=limits, cuffs=free)
    found = dx.design(own, contact.scaled(4.0), settings)
    assert found.found.problem.without == ()
    whole, less = found.tried
    assert (whole.why_not, less.norm_n, less.design) == ("", None, None)
    assert re.search(r"loose: at exo_knee .* 5\.2 N m", less.why_not)


@pytest.mark.slow
def test_a_design_without_a_cuff_is_told_and_written(
    study, tmp_path, monkeypatch
):
    """In tables, files, page and what reads them."""

    def one_less(whole, forecast):
        found = designing._without(whole.found, ("shank",))
        less = replace(whole, found=found, after=forecast(found))
        told = designing._told(whole), designing._told(less)
        return replace(less, tried=told)

    monkeypatch.setattr(designing, "fewer", one_less)
    own, contact = study
    stiff = contact.scaled(4.0)  # two cuffs hold the device
    limits = DesignLimits(
        migration_mm=None, moment_factor=None, effort_factor=None
    )
    free = {"shank": CuffFreedom(removable=True)}
    settings = replace(SETTINGS, limits=limits, cuffs=free)
    found = dx.design(own, stiff, settings)
    assert found.success
    peak = found.peaks["shank"]
    assert peak.model_before > 5.0
    assert peak.model_after == peak.forecast_after == peak.forecast_high == 0.0
    assert found.peaks["thigh"].model_after > 5.0
    (row,) = [r for r in found.felt() if r["cuff"] == "shank"]
    assert set(row["after"].values()) == {0.0} != set(row["before"].values())
    (row,) = [r for r in found.variables() if r["name"] == "shank.removed"]
    assert row["value"] == 1.0
    names = {r["name"] for r in found.variables()}
    assert not names & {"shank.along_m", "shank.strap_normal_n_m"}
    # One kind alone is of all cuffs, and leaves the others' kinds as today.
    alone = designing._alone(found, "places").problem
    held = {v.name for v in alone.design if v.lower == v.upper}
    assert "shank.along_m" not in held
    assert {n for n in held if n.startswith("shank.strap")}
    checks = {c.name: c for c in found.checks()}
    assert checks["design.attached"].value > 0.0
    assert checks["design.attached"].holds
    out = tmp_path / "designed"
    found.write(out)
    assert "left out" in (out / "design.txt").read_text()
    design = read_design(out)
    assert design == found.design and design.removed == ("shank",)
    assert read_design(out / "design_without_none.yaml").removed == ()
    assert "exo_shank_cuff" not in (out / "device.sdf").read_text()
    assert set(dx.read_contact(out, accept=["provenance"]).bushings) == {
        "thigh",
        "pelvis",
    }
    for name in ("forces.png", "device.png"):
        assert (out / name).stat().st_size > 10_000
    page = tmp_path / "page.html"
    assert main(["view", str(out), "--out", str(page)]) == 0
    arrows = player_data(page)["clips"][0]["arrows"]
    assert {"thigh", "shank_measured"} <= set(arrows)
    assert "shank" not in arrows
    # What a prediction is made of.
    built, held = on_design(own, stiff, design)
    posed = dx.PredictionProblem(built.model, built.trials()[:1], held)
    assert set(posed.bushings) == {"thigh", "pelvis"}
    assert all("shank" not in t.cuffs for t in built.trials())


def test_what_is_an_extrapolation_is_named_once_in_order():
    """Cuffs that soften, and what has a variable far from today's."""
    told = SimpleNamespace(
        peaks={"pelvis": None, "thigh": None, "shank": None},
        design=SimpleNamespace(joints={"knee": None, "hip": None}),
        softened=lambda: ["shank"],
        variables=lambda: [
            {"name": "shank.along", "extrapolated": True},
            {"name": "hip.gain", "extrapolated": True},
            {"name": "thigh.across", "extrapolated": False},
            {"name": "pelvis.along", "extrapolated": True},
        ],
    )
    assert Designed.beyond(told) == ["pelvis", "shank", "hip"]


@pytest.mark.parametrize(
    ("over", "name", "told"),
    [
        ("gains", "thigh.along_m", ["design.assistance"]),
        ("gains", "exo_knee.support", []),
        ("angle", "thigh.along_m", []),
    ],
)
def test_gains_that_have_no_drive_to_act_on_are_told(over, name, told):
    row = {"name": name, "value": 0.0, "unit": "m"}
    found = SimpleNamespace(
        settings=DesignSettings(assistance_over=over),
        peaks={},
        after={},
        felt=list,
        softened=list,
        variables=lambda: [row | {"at_bound": False, "extrapolated": False}],
    )
    assert [c.name for c in Designed._notes(found)] == told


def test_cuffs_that_deflect_further_than_today_are_named():
    """By more than a part in a thousand, in either direction."""

    def row(cuff, deflection, migration):
        after = {"deflection_mm": deflection, "migration_mm": migration}
        before = {"deflection_mm": 8.0, "migration_mm": 5.0}
        return {"cuff": cuff, "before": before, "after": after}

    told = SimpleNamespace(
        felt=lambda: [
            row("pelvis", 8.004, 5.004),
            row("thigh", 8.02, 4.0),
            row("shank", 7.0, 5.02),
        ]
    )
    assert Designed.softened(told) == ["thigh", "shank"]


def test_mats_and_model_differ_by_their_largest_forces():
    """Means over trials with mats of a cuff; by a factor of 2 at most."""

    def trial(**peaks):
        return SimpleNamespace(
            cuffs={
                c: SimpleNamespace(normal=np.array([1.0, -p, 2.0]))
                for c, p in peaks.items()
            }
        )

    model = {"shank": 10.0, "thigh": 40.0, "pelvis": 20.0, "foot": 5.0}
    moved = [
        SimpleNamespace(
            trial=trial(**model), measured=trial(thigh=30.0, pelvis=90.0)
        ),
        SimpleNamespace(
            trial=trial(**{**model, "thigh": 20.0}),
            measured=trial(thigh=45.0, shank=4.0),
        ),
    ]
    assert designing.differences(moved) == {
        "shank": 0.5,
        "thigh": 75.0 / 60.0,
        "pelvis": 2.0,
    }


@pytest.mark.slow
def test_migration_is_what_encoders_tell():
    """Mean over trials with encoders of the largest; by a factor of 2."""
    made = dx.synthetic.rises_in_device(1, nodes_per_second=25.0)
    (trial,), model, contact = made.trials, made.model, made.contact
    names = trial.coordinates
    who = Wearer("she", model, contact, ())

    def tilted(degrees):
        q = trial.q.copy()
        q[:, names.index("exo_knee")] += np.deg2rad(degrees)
        return replace(trial, q=q)

    def migration(t, cuff):
        d = replace(who, trials=(t,)).largest_deflection(cuff)
        # Device's point in the human's frame, along the limb, by rigid bodies.
        human, device = model.tree.cuffs[cuff]
        own = contact.bushings[cuff].origin
        q = t.q
        at = model.tree.point_positions(q, device, np.array(own))
        zero = model.tree.point_positions(q, human, np.array(own))
        up = model.tree.point_positions(q, human, np.add(own, (0.0, 1.0)))
        along = np.sum((at - zero) * (up - zero), axis=1)
        assert d[0] == pytest.approx(np.abs(along).max(), abs=1e-9)
        return d[0]

    study = dx.Study(model, [trial], name="she")
    moved = [
        Moved(tilted(1.0), None, trial, tilted(1.5)),
        Moved(tilted(2.0), None, trial, tilted(2.4)),
        Moved(tilted(9.0), None, trial, None),
    ]

    def slid(moved):
        return designing.wearer(study, who, moved).slid

    found = slid(moved)
    for cuff in ("thigh", "pelvis"):
        seen, had = (
            max(migration(t, cuff) for t in (a, b))
            for a, b in (
                (tilted(1.5), tilted(2.4)),
                (tilted(1.0), tilted(2.0)),
            )
        )
        assert found[cuff] == pytest.approx(np.clip(seen / had, 1.0, 4.0))
    assert found["pelvis"] > 1.05
    less = [Moved(tilted(2.4), None, trial, tilted(2.0))]
    assert set(slid(less).values()) == {1.0}
    assert slid(moved[2:]) == {}


@pytest.mark.slow
def test_a_device_s_torques_are_on_the_clock_that_is_found(monkeypatch):
    """By 24 ms too early, a drive seemed to do 27 % more work in squats."""
    made = synthetic.rises_in_device(1, nodes_per_second=20)
    late = {"delays_s": {"encoders": 0.0}, "clocks": {"encoders": "unknown"}}
    (trial,) = trials = [replace(made.trials[0], provenance=late)]
    clocks = [Clock(trial.name, "encoders", 0.03, 0.004)]
    expected = retimed(trial, clocks)
    assert np.abs(expected.moments - trial.moments).max() > 0.01
    own, posed = dx.Study(made.model, trials, name="somebody"), []

    def first(problem, _):
        posed.append(problem)
        raise KeyboardInterrupt

    monkeypatch.setattr(designing, "find_clocks", lambda *_: clocks)
    monkeypatch.setattr(designing, "solved", first)
    known = Posterior((), np.zeros(0), np.zeros((0, 0)))
    contact = replace(made.contact, posterior=known)
    for begin in (
        lambda: dx.design(own, contact, SETTINGS),
        lambda: on_design(own, contact, Design(), clocks),
    ):
        with pytest.raises(KeyboardInterrupt):
            begin()
    assert len(posed) == 2
    for problem in posed:
        (used,) = problem.trials
        np.testing.assert_allclose(used.moments, expected.moments, atol=1e-9)
        # The prior of the lag that is left is no longer that of the recording.
        mean, covariance = problem.errors.prior()
        k = problem.errors.names.index(f"{trial.name}.encoder_clock")
        assert mean[k] == pytest.approx(0.0, abs=1e-12)
        assert covariance[k, k] == pytest.approx(0.004**2)


@pytest.mark.slow
def test_springs_answer_once_on_a_design(monkeypatch):
    """In the prediction; the trial that it begins with has them as measured."""
    monkeypatch.setattr(designing, "posture_law", lambda *args: {})
    made = synthetic.rises_in_device(1, nodes_per_second=20)
    (trial,) = made.trials
    own = dx.Study(made.model, made.trials, name="somebody")
    own.device = Device(knee=JointDrive(stiffness_nm_rad=60.0, rest_deg=20.0))
    soft = Design({"thigh": CuffDesign(strap_normal_n_m=1000.0)})
    built, held = on_design(own, made.contact, soft)
    (given,) = built.trials()
    np.testing.assert_allclose(given.moments, trial.moments, atol=1e-9)
    found = dx.predict(built, given, held)
    at = trial.sample(found.times)
    off = found.coordinate("exo_knee") - at.coordinate("exo_knee")
    assert np.abs(60.0 * off).max() > 1.0
    more = found.moment("exo_knee") - at.moment("exo_knee")
    posed, values = found.result.problem, found.result.values
    errors = values[posed.program.indices(posed.error_variables)]
    zero = errors[posed.errors.names.index("encoder.exo_knee")]
    np.testing.assert_allclose(more, -60.0 * (off + zero), atol=0.6)


@pytest.mark.slow
def test_a_prediction_s_torques_are_those_of_the_forecast(study, monkeypatch):
    """They answer where the device goes on other cuffs; the person bears it."""
    own, contact = study
    law = {"exo_hip": np.array([0.0, 0.0, 60.0])}
    monkeypatch.setattr(designing, "posture_law", lambda *args: law)
    soft = {"pelvis": CuffDesign(strap_normal_n_m=1000.0)}
    design = Design(soft)
    built, _ = on_design(own, contact, design)
    who = Wearer(own.name, own.model, contact, ())
    before = designing.movements(own, who, own.design)
    who = designing.wearer(own, who, before)
    after = designing.movements(own, who, own.design, design)
    turn = np.array([-1.0, 1.0, -1.0])  # of the trunk's link, by the joints
    for trial, given, today, there in zip(
        own.trials("prediction"), built.trials(), before, after, strict=True
    ):
        names = trial.coordinates
        leant, leans = (
            m.trial.q[:, names.device_columns] @ turn for m in (today, there)
        )
        more = replace(trial, moments=given.moments - trial.moments)
        at = more.sample(today.trial.times)
        expected = 60.0 * np.cos(leant) * (leans - leant)
        assert np.abs(expected).max() > 0.3
        np.testing.assert_allclose(at.moment("exo_hip"), expected, atol=0.02)
        np.testing.assert_allclose(at.moment("hip"), -expected, atol=0.02)
        np.testing.assert_allclose(at.moment("exo_knee"), 0.0, atol=1e-9)


def test_drives_are_read_where_encoders_tell_of_the_device(monkeypatch):
    model = nominal_model("coupled")
    own, contact = worn.trial(model), nominal_contact(model)
    study = dx.Study(model, [own], name="somebody")
    seen = replace(own, name="seen")
    told = Moved(own, None, own, seen)
    asked = []
    monkeypatch.setattr(
        designing, "posture_law", lambda *args: asked.append(args) or "law"
    )
    who = Wearer("she", model, contact, ())
    found = designing.wearer(study, who, [told, told])
    assert (found.name, found.law, found.trials) == ("she", "law", (own, own))
    ((of, noise),) = asked
    assert [t.name for t in of.trials] == ["seen", "seen"]
    assert of.model is model
    assert noise == study.prediction.noise.exo_moment_nm
    blind = designing.wearer(study, who, [Moved(own, None, own)])
    assert blind.name == "she" and asked[1][0].trials == []


def test_a_forecast_is_of_what_each_wearer_s_mats_would_show():
    """Means over trials; a band grows with the factor and never shrinks."""

    def trial(peak):
        force = CuffForce.of(np.outer([1.0, -peak, 2.0], [0.0, 1.0, 0.0]))
        times = np.array([0.0, 0.5, 1.0])
        return SimpleNamespace(cuffs={"thigh": force}, times=times, duration=1)

    band = np.outer([1.0, 4.0, 1.0], [0.0, 1.0, 0.0])
    bands = worn.bands_of({"thigh": band}, {})

    def moved(*peaks):
        return [
            SimpleNamespace(trial=trial(p), bands=bands, measured=trial(mats))
            for p, mats in peaks
        ]

    factors = {"a": 0.75, "b": 1.5}
    wearers = {
        name: Wearer(name, None, None, (), differ={"thigh": factor})
        for name, factor in factors.items()
    }
    told = SimpleNamespace(
        worn=wearers,
        before={"a": moved((40, 30), (20, 15)), "b": moved((60, 90))},
        after={"a": moved((16, 0), (8, 0)), "b": moved((30, 0))},
        measured={},
    )
    forecast = (0.75 * 16 + 0.75 * 8 + 1.5 * 30) / 3
    width = (4.0 + 4.0 + 1.5 * 4.0) / 3
    assert Designed._peak(told, "thigh") == Peak(
        measured_before=45.0,
        today=45.0,
        model_before=40.0,
        model_after=18.0,
        forecast_after=pytest.approx(forecast),
        forecast_low=pytest.approx(forecast - width),
        forecast_high=pytest.approx(forecast + width),
    )


@pytest.mark.slow
def test_what_lies_beyond_calibration_is_marked(found):
    rows = found.variables()
    far = [r for r in rows if r["unit"] == "m" and abs(r["value"]) > 0.03]
    assert far and all(r["extrapolated"] for r in far)
    assert found.summary()["extrapolated"]
    assert "beyond what was calibrated" in found.table()
    notes = {c.name for c in found.checks() if not c.holds}
    assert "design.extrapolation" in notes


@pytest.mark.slow
def test_built_forces_stand_beside_the_forecast(found):
    """What was measured on the design: here the forecast's own forces."""
    trials = [m.trial for ms in found.after.values() for m in ms]
    (name,) = found.after
    built = replace(found, measured={name: trials})
    for peak in built.peaks.values():
        assert peak.measured_after is not None
    assert built.support["measured_after"] == pytest.approx(
        sum(t.device_work for t in trials)
    )
    (legend,) = forces_figure(built).legends
    assert {t.get_text() for t in legend.get_texts()} == {
        "today",
        "design",
        "measured today",
        "measured as built",
    }


@pytest.mark.slow
def test_less_support_costs_less_force(found):
    rows = pareto_front(found, (0.6, 1.0))
    assert [r["share"] for r in rows] == [0.6, 1.0]
    assert rows[0]["norm_n"] < rows[1]["norm_n"]
    assert rows[0]["work_j"] == pytest.approx(0.6 * rows[1]["work_j"], rel=0.02)


@pytest.mark.parametrize(("given", "kept"), [(None, 0.005), (0.02, 0.02)])
def test_a_front_keeps_its_shares_where_a_design_need_not(
    given, kept, monkeypatch
):
    asked = []

    def posed(_, settings, **__):
        asked.append(settings.limits.support)
        raise KeyboardInterrupt

    monkeypatch.setattr(designing, "DesignProblem", posed)
    settings = replace(SETTINGS, limits=DesignLimits(support=given))
    problem = SimpleNamespace(wearers=[], without=())
    made = SimpleNamespace(
        found=SimpleNamespace(problem=problem), settings=settings, today=None
    )
    assert pareto_front(made) == []
    assert asked == [kept]


@pytest.mark.slow
def test_a_failed_design_is_sealed_and_written_as_such(found, tmp_path):
    short = replace(SETTINGS, solver=replace(SOLVER, max_iterations=2))
    wearers = found.found.problem.wearers
    failed = DesignProblem(wearers, short, today=found.today).solve()
    made = replace(found, found=failed)
    assert not made.success
    assert made.write(tmp_path).exit_code == 1
    assert not (tmp_path / "design.yaml").exists()
    with pytest.raises(dx.SealedSolutionError):
        made.design  # noqa: B018


@pytest.mark.slow
def test_studies_and_calibrations_must_match(study):
    own, contact = study
    with pytest.raises(InputError, match="1 studies and 2 calibrations"):
        dx.design(own, [contact, contact])


@pytest.mark.slow
def test_wearers_whose_files_would_be_called_alike_are_refused(study):
    """One's movements were written over the other's."""
    own, contact = study
    trial, _ = own.trials()
    pair = [
        dx.Study(own.model, [replace(trial, name=called)], name=name)
        for name, called in (("a", "b_c"), ("a_b", "c"))
    ]
    with pytest.raises(InputError, match=r"'a' and one of 'a_b' .* 'a_b_c'"):
        dx.design(pair, [contact, contact])


def test_what_cannot_be_designed_is_told_before_anything_is_solved(study):
    own, contact = study
    trials = [replace(t, moments=None) for t in own.trials()]
    settings = replace(SETTINGS, cuffs={"tigh": CuffFreedom()})
    with pytest.raises(InputError, match=r"design\.cuffs\.tigh"):
        dx.design(dx.Study(own.model, trials), contact, settings)


def test_what_is_asked_in_python_is_checked(study):
    own, contact = study
    ground = replace(contact, bushings={})
    with pytest.raises(InputError, match="holds no interaction parameters"):
        dx.design(own, ground)
    with pytest.raises(InputError, match="settings: points"):
        dx.design(own, contact, DesignSettings(points=0))
    with pytest.raises(InputError, match="study is None; give a Study"):
        dx.design(None, contact)
    with pytest.raises(InputError, match="settings: torque_limit_nm is"):
        dx.predict(
            own, own.trials()[0], contact,
            settings=dx.PredictionSettings(torque_limit_nm=np.nan),
        )  # fmt: skip
    with pytest.raises(InputError, match=r"foot_ground is Pred.*FootGroundS"):
        dx.Study(own.model, own.trials(), foot_ground=dx.PredictionSettings())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("order: 2", "order is 2, but must be at least 4"),
        ("order: 200", "order is 200, but must be at most 100"),
        ("draws: 100000", "draws is 100000, but must be at most 1000"),
        (
            "cuffs: {thigh: {along_m: [0.1, 0.2]}}",
            "must include its value today",
        ),
        ("assistance: [1.1, 1.2]", "must include today's factor"),
        ("assistance: [0.7, 130]", "is 130, but must be at most 50"),
        (
            "cuffs: {thigh: {area: [0.5, 150]}}",
            "is 150, but must be at most 50",
        ),
        ("limits: {support: -1}", "support is -1"),
        (
            "limits: {pressure_kpa: 8000}",
            "pressure_kpa is 8000, but must be at most 1000 kPa",
        ),
        (
            "limits: {moment_factor: 100}",
            "moment_factor is 100, but must be at most 50",
        ),
        (
            "cuffs: {thigh: {area_m2: 100}}",
            r"area_m2 is 100, but must be at most 1 m\^2",
        ),
        (
            "gains: {stiffness_nm_rad: 5}",
            "gains are those of assistance_over: gains, but it is angle",
        ),
        (
            "population: {height_m: [1.7, 0.1], mass_kg: [70, 10], "
            "percentiles: [50, 50]}",
            "percentile is given twice",
        ),
        (
            "population: {height_m: [1.7, 0.1], mass_kg: [70, 10], "
            "percentiles: [0.05, 0.5, 0.95]}",
            "percentiles are all below 1 %, up to 0.95; give per cent",
        ),
        (
            "population: {height_m: [1.7, 0.1], mass_kg: [70, 10], "
            "percentiles: []}",
            "percentiles is empty; give at least one",
        ),
        (
            "population: {height_m: [170, 10], mass_kg: [70, 10]}",
            "5th percentile height_m must lie between 0.9 and 2.6 m, not 15",
        ),
        (
            "population: {height_m: [1.7, 0.1], mass_kg: [70, 40]}",
            "5th percentile mass_kg must lie between 15 and 350 kg, not 4.",
        ),
    ],
)
def test_wrong_settings_are_one_sentence(text, said):
    with pytest.raises(InputError, match=said):
        schema.load_text(text, DesignSettings)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((1.7, (70.0, 10.0)), "height_m is 1.7; give mean and standard dev"),
        (((1.7, 0.1), (70.0,)), r"mass_kg is \(70.0,\); give mean and"),
        (
            ((1.7, "a"), (70.0, 1.0)),
            "height_m must be a number .m., but is 'a'",
        ),
    ],
)
def test_sizes_in_python_are_one_sentence_too(given, said):
    with pytest.raises(InputError, match=said):
        Population(*given)


@pytest.mark.slow
def test_a_population_that_bears_a_load_is_told_before_work(monkeypatch):
    """Solving the own movements comes after."""
    made = synthetic.rises_in_device(1, nodes_per_second=20)
    (rise,) = made.trials
    loaded = replace(rise, applied={"thigh": rise.ground})
    monkeypatch.setattr(designing, "movements", None)
    settings = DesignSettings(population=Population((1.7, 0.1), (70.0, 10.0)))
    with pytest.raises(InputError, match="trial rise1 has a chair or a load"):
        dx.design(dx.Study(made.model, [loaded]), made.contact, settings)


def test_a_missing_calibration_is_one_sentence(capsys, tmp_path, data_root):
    path = data_root.parent / "nowhere.yaml"
    assert main(["design", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "cannot be read" in capsys.readouterr().err


def test_a_step_without_data_has_no_effect_on_a_design():
    study = SimpleNamespace(name="anna", prediction=PredictionSettings())
    assert without_effect(study) == []
    study.prediction = PredictionSettings(ends="periodic")
    assert (
        "note  design.ends (anna, prediction.ends: periodic): has no effect, "
        "nor has the step's speed" in Verdict((*without_effect(study),)).text()
    )


def test_a_wearer_given_twice_is_one_sentence(capsys, tmp_path):
    twice = [str(tmp_path / "a.yaml"), f"{tmp_path}/./a.yaml"]
    assert main(["design", *twice, "--out", str(tmp_path / "out")]) == 2
    assert "give each wearer once" in capsys.readouterr().err


def test_a_calibration_is_compared_with_what_it_is_to_design(
    monkeypatch, capsys, tmp_path
):
    """As before a prediction: their filter and the plates' lag may differ."""
    asked = []

    def calibrated(folder, accepted, trials=()):
        asked.append(trials)
        raise InputError("the calibration is judged here")

    study = SimpleNamespace(
        name="anna",
        prediction=PredictionSettings(),
        gate=lambda *_: (),
        trials=lambda use: (use,),
        calibrated=calibrated,
    )
    monkeypatch.setattr("drake_exo.cli.design.read_study", lambda *_: study)
    out, made = str(tmp_path / "out"), str(tmp_path)
    command = ["design", "a.yaml", "--calibration", made, "--out", out]
    assert main(command) == 2
    assert "is judged here" in capsys.readouterr().err
    assert asked == [("prediction",)]
