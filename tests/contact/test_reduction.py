"""Spheres that stand for a sole: known ones come back, errors are told."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from drake_exo import cli
from drake_exo.contact import reduction
from drake_exo.contact.diagram import build_diagram
from drake_exo.contact.hunt_crossley import (
    SimbodyConstants,
    friction_coefficient,
    sphere_force,
)
from drake_exo.contact.parameters import ContactModel
from drake_exo.contact.reduction import (
    SoleLaw,
    SoleSphere,
    reduce_sole,
    softened,
)
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.model.assembly import Assembly, Person
from drake_exo.model.description import nominal_human
from drake_exo.model.plant import Model
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.loads import Load
from drake_exo.soles.results import SoleSamples, sole_samples

SIZE = np.array([0.26, 0.1, 0.03])
E = np.array([3e7, 6e7, 2e7])
PLACE = np.array(
    [[-0.1, 0.0, -0.005], [0.05, 0.03, -0.005], [0.1, -0.03, -0.004]]
)
RADIUS, SHARE = 0.032, 0.15


def _poses(count=40, planar=False):
    s = np.linspace(0, 1, count)
    pitch = -0.02 + 0.04 * s
    roll = 0 * s if planar else 0.01 * np.sin(7 * s)
    c, sn = np.cos(pitch), np.sin(pitch)
    R = np.zeros((count, 3, 3))
    R[:, 0, 0], R[:, 0, 2], R[:, 2, 0], R[:, 2, 2] = c, sn, -sn, c
    R[:, 1, 1] = 1.0
    tilt = np.zeros_like(R)
    tilt[:, 0, 0] = 1.0
    tilt[:, 1, 1] = tilt[:, 2, 2] = np.cos(roll)
    tilt[:, 1, 2], tilt[:, 2, 1] = -np.sin(roll), np.sin(roll)
    height = 0.0285 - 0.001 * np.sin(np.pi * s)
    return np.stack([0 * s, 0 * s, height], axis=1), tilt @ R


def _truth(planar=False):
    """Samples of spheres, by a loop of its own."""
    origin, R = _poses(planar=planar)
    place = PLACE * [1, 0, 1] if planar else PLACE
    constants = softened(SHARE)
    force, cop = np.zeros(len(origin)), np.zeros((len(origin), 2))
    for q, (O, turn) in enumerate(zip(origin, R, strict=True)):  # noqa: E741
        for modulus, p in zip(E, place, strict=True):
            x, y, z = O + turn @ p
            normal, _ = sphere_force(
                "simbody", RADIUS - z, 0.0, 0.0, modulus, 0.0, RADIUS, constants
            )
            force[q] += normal
            cop[q] += normal * np.array([x, y])
    return _samples(origin, R, force, cop / force[:, None])


def _samples(origin, R, force, cop):
    """Of a sole whose frame is above its middle."""
    friction = SimbodyConstants.static_friction
    return SoleSamples(
        origin, R, force, cop, SIZE, np.zeros(2), friction, 0.07 + 0 * force
    )


def test_smoothing_of_a_centimetre_is_the_law_s_own():
    usual = SimbodyConstants()
    assert softened(1.0) == replace(usual, viscous_friction=0.0)
    assert softened(0.5).hertz_smoothing == 600.0


def test_a_law_slips_at_the_sole_s_friction_however_fast():
    force, constants = 300.0, softened(SHARE, 0.35)
    for speed in (0.2, 2.0):
        mu = friction_coefficient("simbody", speed, constants)
        assert mu * force == pytest.approx(0.35 * force)


@pytest.mark.slow
@pytest.mark.parametrize("planar", [True, False])
def test_spheres_are_found_again(planar):
    found = reduce_sole(_truth(planar), 3, planar)
    assert found.force_error < 3e-4
    assert found.cop_error < 5e-6
    assert found.is_near
    rows = found.table()
    np.testing.assert_allclose(rows["force_n"], found.samples.force)
    assert ("cop_y_m" in rows) == (not planar)
    assert repr(found) == (
        "Reduction(3 spheres; force off by 0.0 %, centre of pressure by 0.0 mm "
        "RMS)"
    )


@pytest.mark.slow
def test_errors_are_those_of_what_is_written():
    """One sphere cannot do it; the figures are those of its own table."""
    found = reduce_sole(_truth(), 1, False)
    rows = found.table()
    off = rows["force_spheres_n"] - rows["force_n"]
    wanted = np.sqrt((off**2).mean()) / rows["force_n"].max()
    assert found.force_error == pytest.approx(wanted)
    loaded = rows["loaded"].astype(bool)
    dx = (rows["cop_x_spheres_m"] - rows["cop_x_m"])[loaded]
    dy = (rows["cop_y_spheres_m"] - rows["cop_y_m"])[loaded]
    wanted = np.sqrt((dx**2 + dy**2).mean())
    assert found.cop_error == pytest.approx(wanted)
    assert not found.is_near
    # At most 2 cm from where its lowest point is the sole's.
    off = found.place[:, 2] - (RADIUS - SIZE[2])
    assert np.abs(off).max() <= 0.02 + 1e-9
    with pytest.raises(InputError, match="--spheres 2"):
        _ = found.law


def test_too_few_samples_are_refused():
    whole = _truth()
    few = _samples(*(x[:3] for x in whole[:4]))
    with pytest.raises(InputError, match="fewer spheres"):
        reduce_sole(few, 3, False)
    # Nor does one tell more by being there nine times: a load that stays.
    same = _samples(*(np.repeat(x[:1], 9, axis=0) for x in whole[:4]))
    with pytest.raises(InputError, match=r"samples \(1 that differ\)"):
        reduce_sole(same, 2, False)
    for spheres in (0, 1.5):
        with pytest.raises(InputError, match="give a whole number from 1"):
            reduce_sole(few, spheres, False)
    for other in ("results", Case.from_text(EXAMPLE)):
        with pytest.raises(InputError, match="sole_samples returns"):
            reduce_sole(other, 3)
    # A centre of pressure tells nothing where hardly anything bears.
    force = np.where(np.arange(len(whole.force)) < 2, whole.force, 1e-9)
    with pytest.raises(InputError, match="fewer spheres"):
        reduce_sole(whole._replace(force=force), 11, False)


@pytest.mark.slow
def test_the_command_writes_law_and_samples(tmp_path, capsys):
    case = Case.from_text(EXAMPLE + "contact: {friction: 0.35}\n")
    zmp = np.linspace([-0.04, 0.0], [0.04, 0.0], 9)
    force = np.tile([0.0, 0.0, 300.0], (9, 1))
    load = Load(0.1 * np.arange(9), force, zmp)
    step = replace(case, load=load).simulate()
    step.write(tmp_path)
    out = tmp_path / "law.yaml"
    argv = ["sole", "reduce", str(tmp_path), "--spheres", "2", "--planar",
            "--out", str(out)]  # fmt: skip
    assert cli.main(argv) in (0, 1)
    law = yaml.safe_load(out.read_text())
    assert law["planar"] and list(law["spheres"]) == ["sphere1", "sphere2"]
    assert law["constants"]["static_friction"] == 0.35
    assert law["constants"]["dynamic_friction"] == 0.35
    assert f"{100 * law['force_error_rms']:.1f} %" in capsys.readouterr().out
    assert out.with_suffix(".csv").is_file()
    # From Python, of the step or its folder: the same files.
    for sole in (step, tmp_path):
        found = reduce_sole(sole_samples(sole), 2, planar=True)
        found.write(tmp_path / "again.yaml")
        for end in (".yaml", ".csv"):
            again = tmp_path / f"again{end}"
            assert again.read_bytes() == out.with_suffix(end).read_bytes()
    with pytest.raises(InputError, match="cannot be written"):
        found.write(out / "law.yaml")
    assert cli.main(argv) == 2
    said = capsys.readouterr().err
    assert f"{out}: exists; choose another file for --out, or replace" in said
    assert (
        cli.main(["sole", "reduce", "nowhere", "--out", str(out), "--force"])
        == 2
    )


def test_force_replaces_no_file_but_a_law(tmp_path, capsys):
    case = tmp_path / "case.yaml"
    case.write_text(EXAMPLE)
    argv = ["sole", "reduce", str(tmp_path), "--out", str(case), "--force"]
    assert cli.main(argv) == 2
    assert "is not an earlier law" in capsys.readouterr().err
    assert case.read_text() == EXAMPLE


def _law(**changes):
    spheres = {
        f"s{k}": SoleSphere(float(e), x_m=x, y_m=y, z_m=z, radius_m=RADIUS)
        for k, (e, (x, y, z)) in enumerate(
            zip(E, PLACE + np.array([0, 0, 0.007]), strict=True)
        )
    }
    law = SoleLaw(tuple(SIZE.tolist()), spheres, softened(SHARE))
    return replace(law, **changes)


@pytest.mark.slow
def test_what_is_written_is_read(tmp_path):
    law = reduce_sole(_truth(), 3, False).law
    path = tmp_path / "law.yaml"
    path.write_text(schema.dump_text(law))
    assert SoleLaw.read(path) == law


@pytest.mark.parametrize(
    ("sphere", "size", "words"),
    [
        ("modulus_n_m2: 20", "0.26, 0.1, 0.02", "modulus_n_m2 is 20, but"),
        ("modulus_n_m2: 2.0e7, x_m: -100", "0.26, 0.1, 0.02", "at least -3 m"),
        ("modulus_n_m2: 2.0e7", "260, 100, 22", "size_m.0. is 260, but"),
    ],
)
def test_a_law_in_other_units_is_refused(sphere, size, words):
    """A solve looked for 300 iterations how a foot stands on it."""
    spheres = f"spheres: {{heel: {{{sphere}}}, toe: {{modulus_n_m2: 2.0e7}}}}"
    with pytest.raises(InputError, match=words):
        schema.load_text(f"size_m: [{size}]\n{spheres}", SoleLaw)


@pytest.mark.parametrize(
    ("heel", "more", "words"),
    [
        ("x_m: -1.0", "", r"their x_m lie up to 1\.1 m apart"),
        ("y_m: 0.3", "", r"their y_m lie up to 0\.3 m apart"),
        ("z_m: -0.1", "", r"their z_m - radius_m lie up to 0\.11 m"),
        ("radius_m: 0.32", "", r"heel reaches down to -0\.32 m"),
        ("z_m: 0.01", "constants: {static_friction: 0.3}", "give both, the"),
    ],
)
def test_a_law_edited_by_hand(heel, more, words):
    """Half a metre up, x and z exchanged, one friction of two."""
    spheres = (
        f"heel: {{modulus_n_m2: 2.0e7, {heel}}}, "
        "toe: {modulus_n_m2: 2.0e7, x_m: 0.1, z_m: 0.01}"
    )
    text = f"size_m: [0.26, 0.1, 0.022]\nspheres: {{{spheres}}}\n{more}"
    with pytest.raises(InputError, match=words):
        schema.load_text(text, SoleLaw)
    # A large sphere's centre is higher up than a small one's.
    high = "z_m: 0.13, radius_m: 0.15"
    schema.load_text(text.replace(heel, high).removesuffix(more), SoleLaw)
    # What all of them share: the sole's depth ten times too large.
    deep = text.replace(heel, "z_m: 0.01").removesuffix(more)
    schema.load_text(deep, SoleLaw)
    with pytest.raises(InputError, match=r"off the bottom of its sole at -0.3"):
        schema.load_text(deep.replace("0.022", "0.3"), SoleLaw)


@pytest.mark.parametrize("at", [(0.05, 0.04), (-0.04, 0.05)])
def test_a_sole_above_the_ankle_is_refused(at):
    """Its z without a sign, or exchanged with x: a fit hid it in the floor."""
    model = Model(Assembly(Person("one")), nominal_human())
    with pytest.raises(InputError, match=r"sole_at_m: the bottom .* at z = 0"):
        _law().ground(model, at)
    _law().ground(model, (0.05, -0.04))


@pytest.mark.parametrize("legs", ["one", "two"])
def test_feet_press_as_the_soles_do(legs):
    """A diagram's ground reaction, level and 1.2 mm deep, against one sole's.

    The sole's bottom is where the foot's is, under the middle of its spheres.
    """
    model = Model(Assembly(Person(legs)), nominal_human())
    law, deep = _law(), 1.2e-3
    built = build_diagram(model, ContactModel(law.ground(model)))
    context = built.diagram.CreateDefaultContext()
    plant = built.plant
    feet = [b for b in built.contacts]
    q = np.zeros(plant.num_positions())
    own = built.plant_context(context)
    plant.SetPositions(own, q)
    foot = plant.GetBodyByName(feet[0])
    height = foot.EvalPoseInWorld(own).translation()[2]
    q[1] = model.human.ankle_height_m - deep - height
    plant.SetPositions(own, q)
    wanted = 0.0
    for sphere in law.spheres.values():
        depth = sphere.radius_m - (sphere.z_m + SIZE[2] - deep)
        wanted += sphere_force(
            "simbody", depth, 0.0, 0.0, sphere.modulus_n_m2,
            sphere.dissipation_s_m, sphere.radius_m, law.constants,
        )[0]  # fmt: skip
    assert wanted > 100.0
    total = 0.0
    for body in feet:
        end = f"_{body}" if len(feet) > 1 else ""
        port = built.diagram.GetOutputPort("ground_reaction" + end)
        total += port.Eval(context)[1]
    assert total == pytest.approx(2 * wanted, rel=1e-9)
    middle = np.mean([x for x, _ in model.spheres.values()])
    places = [s.x for s in law.ground(model).spheres.values()]
    np.testing.assert_allclose(places, middle + PLACE[:, 0])


def test_a_place_of_one_s_own():
    model = Model(Assembly(), nominal_human())
    ground = _law().ground(model, (0.01, -0.05))
    sphere = ground.spheres["s1"]
    assert sphere.x == pytest.approx(0.01 + PLACE[1, 0])
    assert sphere.z == pytest.approx(-0.05 + PLACE[1, 2] + 0.007)


def test_toes_that_bend_are_refused():
    model = Model(Assembly(Person("two", "hinged")), nominal_human())
    with pytest.raises(InputError, match="rigid"):
        _law().ground(model)


def test_how_deep_a_sole_is():
    """By the lowest of its corners, of a pose that pitches and rolls."""
    c, s = np.cos(0.02), np.sin(0.02)
    pitched = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    rolled = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    one = np.ones(1)
    for turn, arm in ((np.eye(3), 0.0), (pitched, 0.13), (rolled, 0.05)):
        level = np.array([[0.3, 0.2, 0.029]])
        found = _samples(level, turn[None], one, np.zeros((1, 2)))
        lowest = 0.029 - turn[2, 2] * 0.03 - arm * s
        assert reduction.depth(found) == pytest.approx(-lowest)
    high = _samples(level + 0.1, turn[None], one, np.zeros((1, 2)))
    assert reduction.depth(high) == 1e-6


def test_a_plane_is_the_sole_s_own():
    """However the laboratory is turned."""
    samples = _truth(planar=True)
    plain = reduction._in_plane(samples)
    for yaw in (0.35, 2.0, np.pi):
        c, s = np.cos(yaw), np.sin(yaw)
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        turned = samples._replace(
            origin=samples.origin @ R.T,
            rotation=R @ samples.rotation,
            cop=samples.cop @ R[:2, :2].T,
        )
        flat = reduction._in_plane(turned)
        for found, value in zip(flat, plain, strict=True):
            np.testing.assert_allclose(found, value, atol=1e-14)


def test_a_plane_has_no_roll_nor_sideways():
    """Its pitch is that of the pose; heights and lengths stay."""
    origin, R = _poses()
    samples = _truth()
    moved = origin + np.array([0.1, 0.2, 0.0])
    cop = samples.cop + 0.05
    flat = reduction._in_plane(samples._replace(origin=moved, cop=cop))
    np.testing.assert_allclose(flat.origin[:, 1], 0.0)
    np.testing.assert_allclose(flat.origin[:, 0], 0.1)
    np.testing.assert_allclose(flat.origin[:, 2], origin[:, 2])
    np.testing.assert_allclose(flat.cop[:, 0], samples.cop[:, 0] + 0.05)
    np.testing.assert_allclose(flat.cop[:, 1], 0.0)
    np.testing.assert_array_equal(flat.force, samples.force)
    pitch = np.arctan2(flat.rotation[:, 0, 2], flat.rotation[:, 2, 2])
    np.testing.assert_allclose(np.sin(pitch), R[:, 0, 2])
    eye = np.eye(3)[None]
    np.testing.assert_allclose(
        flat.rotation @ flat.rotation.transpose(0, 2, 1),
        np.repeat(eye, len(R), 0),
        atol=1e-12,
    )
    np.testing.assert_allclose(
        flat.rotation[:, 1], np.tile([0, 1, 0], (len(R), 1))
    )
    assert (np.linalg.det(flat.rotation) > 0.0).all()


def test_what_spheres_bear_is_a_sum_and_a_mean_by_force():
    samples = _truth()
    total, cop = reduction.borne(samples, E, PLACE, softened(SHARE))
    np.testing.assert_allclose(total, samples.force)
    np.testing.assert_allclose(cop, samples.cop)


def test_intervals_are_those_of_least_squares():
    """Of a straight problem: noise from the residuals, by m - n of them."""
    rng = np.random.default_rng(4)
    J = rng.standard_normal((40, 7))
    fun = rng.standard_normal(40)
    best = SimpleNamespace(
        fun=fun, jac=J, x=np.zeros(7), cost=0.5 * np.sum(fun**2)
    )
    variance = np.sum(fun**2) / (40 - 7)
    sd = np.sqrt(variance * np.diag(np.linalg.inv(J.T @ J)))
    np.testing.assert_allclose(reduction._deviations(best), sd)
    best.jac = J * (np.arange(7) != 2)  # nothing is told of the third
    assert reduction._deviations(best)[2] > 1e5 * sd.max()


@pytest.mark.slow
@pytest.mark.parametrize("planar", [True, False], ids=["plane", "space"])
def test_a_frame_beside_the_sole_gives_the_same_spheres(planar):
    """As of a pad under the toes in the frame of an ankle."""
    own, middle = _truth(planar), np.array([0.3, 0.05])
    away = np.array([*middle * [1, not planar], 0])
    origin = own.origin - own.rotation @ away
    moved = own._replace(origin=origin, middle=middle)
    there, here = reduce_sole(moved, 1, planar), reduce_sole(own, 1, planar)
    np.testing.assert_allclose(there.place, here.place + away, atol=1e-5)
    assert there.force_error == pytest.approx(here.force_error, rel=2e-5)
    assert reduction.depth(moved) == pytest.approx(reduction.depth(own))


@pytest.mark.slow
@pytest.mark.parametrize("planar", [True, False], ids=["plane", "space"])
def test_intervals_are_in_the_units_of_what_they_are_of(planar, monkeypatch):
    """A sphere's numbers follow each other; scales are of the sole's size."""
    columns = [0, 1, 3] if planar else [0, 1, 2, 3]
    sd = 0.01 * np.arange(1 + 2 * len(columns))
    monkeypatch.setattr(reduction, "_deviations", lambda best: sd)
    found = reduce_sole(_truth(planar=planar), 2, planar)
    scale = np.array([1.0, 0.1 * SIZE[0], 0.1 * SIZE[1], 1e-3])[columns]
    expected = 1.96 * sd[1:].reshape(2, -1) * scale
    np.testing.assert_allclose(found.interval[:, columns], expected)
    if planar:
        assert (found.interval[:, 2] == 0.0).all()


def test_where_a_centre_of_pressure_counts():
    """From a tenth of the largest force on."""
    force = np.array([100.0, 11.0, 9.0, 0.0, 19.0])
    flat = np.zeros((5, 3))
    R = np.eye(3)[None].repeat(5, 0)
    own = _samples(flat, R, force, flat[:, :2])
    found = reduction.loaded(own)
    np.testing.assert_array_equal(found, [True, True, False, False, True])


def test_how_far_spheres_support_a_sole():
    """In the direction where their polygon reaches least towards the edge."""
    samples = _truth()
    corners = np.array([[x, y] for x in (-1, 1) for y in (-1, 1)])
    place = np.column_stack([0.25 * corners * SIZE[:2], np.zeros(4)])
    found = reduction.Reduction(
        samples, False, np.ones(4), place, softened(SHARE), np.zeros((4, 4)),
        samples.force, samples.cop, samples.arm,
    )  # fmt: skip
    assert found.support_share == pytest.approx(0.5)
    assert found.spin_error == 0.0
    # Narrower to the left; and a sole whose middle they do not hold.
    place[:, 1] = np.minimum(place[:, 1], 0.005)
    assert found.support_share == pytest.approx(0.1)
    away = samples._replace(middle=np.array([0.0, 0.01]))
    assert replace(found, samples=away).support_share == pytest.approx(-0.1)
    # What turns more easily by a fifth, wherever it is.
    assert replace(found, arm=0.8 * samples.arm).spin_error == pytest.approx(
        0.2 * np.sqrt((samples.force**2).mean()) / samples.force.max()
    )
    planar = replace(found, planar=True)
    assert planar.support_share is planar.spin_error is None
    assert "spin_n_m" not in planar.table()
    assert planar.law.spin_error_rms is None
