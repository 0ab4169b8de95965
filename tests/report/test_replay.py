from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from page_reader import clip_titles, network_addresses, player_data
from replayed_results import CONTACT, LEAD, rise, solution, write_results
from replayed_results import MODEL as COUPLED

from drake_exo.calibration.results import (
    MODEL,
    write_contact,
    write_model,
)
from drake_exo.contact.diagram import build_diagram
from drake_exo.contact.parameters import nominal_contact
from drake_exo.contact.strap import TODAY, CuffDesign, Design, write_design
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.files.output import Check, read_json, write_json
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.assembly import Assembly, Person
from drake_exo.model.description import models_path, nominal_human
from drake_exo.model.device_file import with_text
from drake_exo.model.plant import Model, nominal_model
from drake_exo.report import replay
from drake_exo.report.gathering import gather
from drake_exo.report.replay import (
    DrawnModel,
    Replayed,
    _surroundings,
    replay_results,
    write_replay,
)
from drake_exo.report.scene import Scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_results(tmp_path_factory.mktemp("results") / "seated", True)


@pytest.fixture(scope="module")
def page(folder):
    path = folder.parent / "replay.html"
    replay_results(folder, path)
    return path


@pytest.fixture(scope="module")
def clip(page):
    (found,) = player_data(page)["clips"]
    return found


def rows(array, width):
    return array.reshape(-1, width)


@pytest.mark.slow
@pytest.mark.parametrize("body", ["human/pelvis", "exoskeleton/exo_thigh"])
@pytest.mark.parametrize("root", ["simulated", "measured"])
def test_bodies_move_as_drake_says(clip, root, body):
    scene = Scene(COUPLED)
    context = scene.plant.CreateDefaultContext()
    link = scene.plant.GetBodyByName(body.rpartition("/")[2])
    q = rise()
    if root == "measured":
        q = q + LEAD
    found = rows(clip["bodies"][f"/{root}/{body}"], 7)
    assert len(found) == 51  # every 0.02 s
    for k in (0, 17, 50):
        scene.plant.SetPositions(context, q[2 * k])
        X_WB = scene.plant.EvalBodyPoseInWorld(context, link)
        np.testing.assert_allclose(found[k, :3], X_WB.translation(), atol=1e-5)
        w = X_WB.rotation().ToQuaternion().wxyz()
        np.testing.assert_allclose(found[k, 3:] * np.sign(w[0]), w, atol=1e-5)


@pytest.mark.slow
def test_ground_reaction_starts_at_the_centre_of_pressure(clip):
    force = rows(clip["arrows"]["ground"], 6)
    np.testing.assert_allclose(force[50], [0.35, 0, 0, 50, 0, 800], atol=1e-4)
    assert np.isnan(force[0]).any()  # nothing bears on the ground at first
    disc = rows(clip["bodies"]["/cop/both"], 7)
    np.testing.assert_allclose(disc[50, :3], [0.35, 0.0, 0.0], atol=1e-6)
    assert np.isnan(disc[0, 0])


def test_each_foot_has_an_arrow_of_its_own():
    model = Model(Assembly(Person("two")), nominal_human())
    names = model.coordinates
    q = np.zeros((2, len(names)))
    left = np.array([[10.0, 500.0, -50.0], [0.0, 0.0, 0.0]])
    right = np.array([[-10.0, 200.0, -60.0], [0.0, 700.0, -70.0]])
    feet = {"left": left, "right": right}
    motion = Trial(
        "steps",
        names,
        np.array([0.0, 1.0]),
        q,
        q,
        q,
        PlanarWrench.of(left + right),
        feet={side: PlanarWrench.of(w) for side, w in feet.items()},
    )
    drawn = DrawnModel(model)
    arrows = drawn.arrows(motion)
    assert list(arrows) == ["ground_left", "ground_right"]
    np.testing.assert_allclose(
        arrows["ground_left"][0], [0.1, 0.1, 0.0, 10.0, 0.0, 500.0]
    )
    assert np.isnan(arrows["ground_left"][1, 0])
    np.testing.assert_allclose(
        arrows["ground_right"][0], [0.3, -0.1, 0.0, -10.0, 0.0, 200.0]
    )
    discs = drawn.centres_of_pressure(motion)
    np.testing.assert_allclose(discs["/cop/right"][1], [0.1, -0.1, 0.0])
    assert np.isnan(discs["/cop/left"][1, 0])


@pytest.mark.slow
def test_chair_pushes_at_the_height_of_its_seat(clip):
    force = rows(clip["arrows"]["chair"], 6)
    seat = DrawnModel(COUPLED).hip(rise()[:1])[0, 1] - 0.13
    # M_y = z F_x - x F_z = 60 N m with F_x = 0 and F_z = 300 N.
    np.testing.assert_allclose(force[0], [-0.2, 0, seat, 0, 0, 300], atol=1e-4)
    assert np.isnan(force[-1]).any()
    assert np.isfinite(clip["bodies"]["/chair"]).all()


@pytest.mark.slow
def test_cuffs_act_where_and_as_the_diagram_says():
    """Same deflection, hence same force: against the LeafSystem."""
    built = build_diagram(COUPLED, CONTACT)
    context = built.diagram.CreateDefaultContext()
    plant = built.plant
    q = rise()[30]
    plant.SetPositions(built.plant_context(context), q)
    port = built.diagram.GetOutputPort("interaction_forces")
    parts = dict(
        zip(COUPLED.cuffs, port.Eval(context).reshape(3, 3), strict=True)
    )
    motion = Trial(
        "still",
        COUPLED.coordinates,
        np.zeros(1),
        q[None],
        0.0 * q[None],
        0.0 * q[None],
        PlanarWrench.of(np.zeros((1, 3))),
        cuffs={name: CuffForce.of(part[None]) for name, part in parts.items()},
    )
    found = DrawnModel(COUPLED, CONTACT).arrows(motion)
    applied = {
        int(f.body_index): f
        for f in built.bushings.GetOutputPort("spatial_forces").Eval(
            built.bushings.GetMyContextFromRoot(context)
        )
    }
    for name, part in parts.items():
        body = plant.GetBodyByName(name)
        force = applied[int(body.index())]
        X_WB = plant.EvalBodyPoseInWorld(built.plant_context(context), body)
        F = force.F_Bq_W.translational()
        np.testing.assert_allclose(found[name][0, 3:], F, atol=1e-9)
        # The arrow's moment about the body's origin is that applied, but
        # for the bushing's own couple.
        arm = found[name][0, :3] - X_WB.translation()
        at = X_WB @ np.array(force.p_BoBq_B) - X_WB.translation()
        moment = force.F_Bq_W.rotational() + np.cross(at, F)
        couple = part[2] * np.array([0, -1.0, 0])
        np.testing.assert_allclose(np.cross(arm, F) + couple, moment, atol=1e-9)


def test_of_two_legs_cuffs_push_on_their_own():
    text = "human: {legs: two}\n"
    text += "device: {file: hip_only.urdf, weld: {belt: pelvis}}\n"
    text += "cuffs: {strap: {human: thigh_right, device: bar}}\n"
    assembly = with_text(schema.load_text(text, Assembly), models_path())
    model = Model(assembly, nominal_human())
    q = np.zeros((1, len(model.coordinates)))
    motion = Trial(
        *("still", model.coordinates, np.zeros(1), q, q, q),
        PlanarWrench.of(np.zeros((1, 3))),
        cuffs={"strap": CuffForce.of(np.array([[0.0, 9.0, 0.0]]))},
    )
    arrow = DrawnModel(model, nominal_contact(model)).arrows(motion)["strap"]
    np.testing.assert_allclose(arrow[0, [1, 3, 4]], [-0.1, 9.0, 0.0])


def test_measured_mat_shows_the_normal_force(clip):
    force = rows(clip["arrows"]["pelvis_measured"], 6)
    np.testing.assert_allclose(
        np.hypot(force[:, 3], force[:, 5]), 35.0, rtol=1e-6
    )
    assert "thigh_measured" not in clip["arrows"]
    spheres = rows(clip["bodies"]["/spheres/toe"], 7)
    q = rise()[0]
    np.testing.assert_allclose(spheres[0, 0], q[0] + 0.15, atol=1e-6)


@pytest.mark.slow
def test_page_is_small_needs_no_network_and_repeats_itself(folder, page):
    again = folder.parent / "again.html"
    replay_results(folder, again)
    assert page.read_bytes() == again.read_bytes()
    assert len(page.read_bytes()) < 20e6
    assert network_addresses(page) == []
    assert "500 N" in page.read_text()
    assert "<title>Movements of " in page.read_text()
    assert clip_titles(page) == {
        "Calibrated, human and exoskeleton, Phase B": ["B: rise 1"]
    }


@pytest.mark.slow
def test_drake_says_nothing(folder, tmp_path, capfd):
    replay_results(folder, tmp_path / "page.html")
    assert capfd.readouterr() == ("", "")


def test_results_without_their_model_are_refused(tmp_path):
    folder = write_results(tmp_path / "old")
    (folder / MODEL).unlink()
    with pytest.raises(InputError, match=r"model\.json: is missing"):
        replay_results(folder, tmp_path / "page.html")


@pytest.mark.slow
def test_results_of_two_subjects_are_refused(tmp_path):
    write_results(tmp_path / "all/a")
    other = write_results(tmp_path / "all/b")
    model = read_json(other / MODEL, "")
    model["human"]["thigh"]["length_m"] += 0.01
    write_json(other / MODEL, model)
    with pytest.raises(InputError, match="several models"):
        replay_results(tmp_path / "all", tmp_path / "page.html")


@pytest.mark.slow
def test_a_device_is_the_same_wherever_its_file_lies(tmp_path, monkeypatch):
    """Calibrated by the study of one folder, predicted by another's."""
    for name in "ab":
        write_results(tmp_path / name)
    text = "device: {file: hip_only.urdf, weld: {belt: pelvis}}\n"
    assembly = with_text(schema.load_text(text, Assembly), models_path())

    def read_model(folder):
        file = Path(folder.name, "hip_only.urdf")
        device = replace(assembly.device, file=file)
        return Model(replace(assembly, device=device), nominal_human())

    written = []
    monkeypatch.setattr(replay, "read_model", read_model)
    monkeypatch.setattr(replay, "_replayed", lambda results, model: [results])
    monkeypatch.setattr(replay, "write_replay", lambda *a: written.extend(a[2]))
    replay_results(tmp_path, tmp_path / "page.html")
    assert len(written) == 2


def test_unsolved_results_are_refused(tmp_path):
    folder = write_results(tmp_path / "failed")
    summary = read_json(folder / "summary.json", "") | {"rmsd": []}
    write_json(folder / "summary.json", summary)
    for show in (
        lambda: replay_results(folder, tmp_path / "page.html"),
        lambda: gather(folder, ["solved"]),
    ):
        with pytest.raises(InputError, match="no solved trial"):
            show()
    write_json(folder / "summary.json", summary | {"success": False})
    with pytest.raises(InputError, match="--accept solved"):
        replay_results(folder, tmp_path / "page.html")


@pytest.mark.slow
def test_what_does_not_hold_is_marked_on_the_page(tmp_path):
    audit = Check("audit", False, 2.5, 1.0, "N", "rise_1")
    folder = write_results(tmp_path / "off", checks=[audit])
    replay_results(folder, tmp_path / "page.html")
    (clip,) = player_data(tmp_path / "page.html")["clips"]
    assert clip["mark"].startswith("DOES NOT HOLD: audit (rise_1, 2.5 N")


@pytest.mark.slow
def test_a_cuff_that_a_design_leaves_out_pushes_today(tmp_path):
    folder, moved = tmp_path / "designed", solution()
    (folder / TODAY).mkdir(parents=True)
    design = Design({"shank": CuffDesign(removed=True)})
    write_design(folder, design)
    write_model(folder, COUPLED)
    write_contact(folder, design.contact(CONTACT))
    write_contact(folder / TODAY, CONTACT)
    moved.save(folder / f"before_{moved.name}")
    cuffs = {c: f for c, f in moved.cuffs.items() if c != "shank"}
    replace(moved, cuffs=cuffs).save(folder / f"after_{moved.name}")
    summary = {"phase": "design", "success": True, "subjects": ["a"]}
    summary["trials"] = [moved.name]
    write_json(folder / "summary.json", summary)
    replay_results(folder, tmp_path / "page.html")
    data = player_data(tmp_path / "page.html")
    assert {a["name"] for a in data["arrows"]} == set(
        data["clips"][0]["arrows"]
    )
    assert "shank_measured" in data["clips"][0]["arrows"]


@pytest.mark.parametrize(
    ("design", "changed", "words"),
    [
        (Design(), {"subjects": []}, r"summary\.json: subjects is no list"),
        (Design(), {"trials": [3]}, r"summary\.json: trials is no list"),
        (Design(), {"checks": 3}, r"summary\.json: checks are not as"),
        (Design({"foot": CuffDesign()}), {}, r"design\.yaml: cuffs\.foot"),
    ],
)
def test_damaged_results_of_a_design_are_refused(
    design, changed, words, tmp_path
):
    write_design(tmp_path, design)
    write_model(tmp_path, COUPLED)
    summary = {"phase": "design", "success": True}
    summary |= {"subjects": ["a"], "trials": ["b"]}
    write_json(tmp_path / "summary.json", summary | changed)
    with pytest.raises(InputError, match=words):
        replay_results(tmp_path, tmp_path / "page.html")


def test_motion_is_sampled_between_nodes():
    half = solution().sample(np.array([0.005]))
    np.testing.assert_allclose(half.ground.array[0], [0.25, 4.0, -1.4])


def test_spheres_are_under_the_segments_that_touch():
    model = Model(Assembly(Person("two", "hinged")), nominal_human())
    names, times = model.coordinates, np.linspace(0.0, 1.0, 3)
    q = np.zeros((3, len(names)))
    q[:, names.index("knee_left")] = 0.8
    none = PlanarWrench.of(np.zeros((3, 3)))
    trial = Trial("step", names, times, q, 0 * q, 0 * q, none)
    spheres = nominal_contact(model).ground.spheres
    shown = Replayed("", "", DrawnModel(model), trial, None, spheres)
    found = _surroundings(shown, trial)
    assert sorted(found) == [
        f"/spheres/{sphere}_{body}_{side}"
        for sphere, body in (("ball", "foot"), ("heel", "foot"))
        for side in ("left", "right")
    ] + ["/spheres/toe_toes_left", "/spheres/toe_toes_right"]
    for path, poses in found.items():
        sphere, _, body = path.removeprefix("/spheres/").partition("_")
        p = spheres[sphere]
        expected = model.tree.point_positions(q, body, (p.x, p.z))
        np.testing.assert_allclose(poses[:, [0, 2]], expected)


def test_spheres_are_drawn_under_the_feet_that_have_them():
    """One leg: under both; two legs: under the own one, left at +y."""
    for person, places in (
        (Person(), {"foot": [0.1, -0.1]}),
        (Person("two"), {"foot_left": [0.1], "foot_right": [-0.1]}),
    ):
        model = Model(Assembly(person), nominal_human())
        spheres = nominal_contact(model).ground.spheres
        shown = Replayed("", "", DrawnModel(model), None, None, spheres)
        found = {}
        for path, body, sphere, across in replay._spheres(shown):
            name = path.removeprefix("/spheres/")
            assert spheres[name.removesuffix(f"_{body}")] is sphere
            assert (name.endswith(f"_{body}")) == (person.legs == "two")
            assert found.setdefault(body, across) == across
        assert found == places


def test_a_page_looks_at_where_the_feet_are(monkeypatch, tmp_path):
    """To a quarter of a metre, from the right front."""
    q = np.zeros((2, 6))
    motion = Trial(
        "a",
        nominal_model("human").coordinates,
        np.array([0.0, 0.5]),
        q,
        q,
        q,
        PlanarWrench.of(np.array([[0.0, 700.0, 0.0]] * 2)),
    )
    drawn = DrawnModel(nominal_model("human"))
    spheres = nominal_contact(drawn.model).ground.spheres
    seen = []
    monkeypatch.setattr(replay, "_stage", lambda *said: said[1])
    monkeypatch.setattr(
        replay, "write_page", lambda path, stage, page, clips: seen.append(
            (stage, page, clips)
        ),
    )  # fmt: skip
    for x in (0.0, 1.3):
        moved = replace(motion, q=q + x * np.eye(6)[0])
        trial = Replayed("a", "b", drawn, moved, None, spheres)
        write_replay(tmp_path / "p.html", drawn.model, [trial], "a")
    (at, first, clips), (there, second, _) = seen
    assert (at, there) == (0.0, 1.25)
    for a, b in ((first.eye, second.eye), (first.target, second.target)):
        np.testing.assert_allclose(np.subtract(b, a), [1.25, 0.0, 0.0])
    assert first.eye[0] > 1.0 and first.eye[1] < -3.0
    assert abs(first.target[0]) < 0.2
    assert [a.name for a in first.arrows] == ["ground"]
    assert "Both legs are summed" in first.legend[0]
    assert "Cuffs" not in first.legend[0]
    (clip,) = clips
    np.testing.assert_allclose(clip.times, np.linspace(0.0, 0.5, 26))


def test_colours_are_those_of_the_page():
    said = []
    noted = SimpleNamespace(
        SetObject=lambda path, shape, colour: said.append(colour),
        SetProperty=lambda *_: None,
    )
    replay._overlay(noted, "/a", None, "f08a1c", 0.45)
    (colour,) = said
    found = [colour.r(), colour.g(), colour.b(), colour.a()]
    np.testing.assert_allclose(found, [240 / 255, 138 / 255, 28 / 255, 0.45])


def test_what_is_computed_and_what_was_measured_are_told_apart():
    arrows = {a.name: a for a in replay._arrows(COUPLED, "measured")}
    cuffs = list(COUPLED.tree.cuffs)
    for name in (*replay._WRENCHES, *cuffs):
        own, other = arrows[name], arrows[f"{name}_measured"]
        assert own.colour == other.colour and own.opacity > other.opacity
        assert own.metres_per_newton == other.metres_per_newton
        assert other.radius_m > own.radius_m
        assert other.root == "/measured/arrows"
        assert ("normal" in other.text) == (name in cuffs)
        # 0.5 m are 500 N, of cuffs 0.2 m are 50 N.
        length = own.metres_per_newton * (50.0 if name in cuffs else 500.0)
        assert length == pytest.approx(0.2 if name in cuffs else 0.5)
    assert len({arrows[cuff].colour for cuff in cuffs}) == len(cuffs)
    assert [n for n in arrows if n in cuffs] == cuffs[::-1]


def test_a_trial_is_shown_with_its_centre_of_pressure():
    """Recorded frame by frame; out of sight where nothing bears."""
    moves = []

    class Screen:
        def SetTransform(self, path, X, time):
            moves.append((path, round(time, 9), X.translation()))

        def __getattr__(self, name):
            return lambda *_, **__: None

    posed = []
    patch = pytest.MonkeyPatch()

    class Still:
        diagram = SimpleNamespace(ForcedPublish=lambda context: None)
        context = None

        def __init__(self, model, meshcat):
            pass

        def set_pose(self, q, time):
            posed.append((round(time, 9), q))

    with patch.context() as patched:
        patched.setattr(replay, "Scene", Still)
        patched.setattr(replay, "set_stage", lambda *_: None)
        trial = solution()
        replay.show_trial(Screen(), COUPLED, trial)
    times = [t for t, _ in posed]
    np.testing.assert_allclose(times, np.linspace(0.0, trial.duration, 51))
    np.testing.assert_allclose(
        posed[10][1], trial.sample(np.array(times[10:11])).q[0]
    )
    assert [(p, t) for p, t, _ in moves] == [("/cop/both", t) for t in times]
    np.testing.assert_allclose(moves[50][2], [0.35, 0.0, 0.0], atol=1e-9)
    assert moves[0][2][2] < -1.0  # under the floor
