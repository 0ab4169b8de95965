"""Pages that replay soles, and what they are made of."""

import numpy as np
import pytest
from page_reader import clip_titles, network_addresses, player_data

from drake_exo.cli import main
from drake_exo.errors import InputError
from drake_exo.soles.animation import SoleMotion, replay_soles
from drake_exo.soles.contact.law import ContactLaw
from drake_exo.soles.contact.newton import ContactSolver, Start
from drake_exo.soles.elasticity import Sole
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import brick
from drake_exo.soles.settings import MaterialBlock
from drake_exo.soles.simulation import (
    FIRST_HISTORY,
    HISTORY,
    simulate,
    write_history,
)

TIMES = np.linspace(0.0, 0.4, 9)


@pytest.fixture(scope="module")
def step():
    """A brick under a force that rolls from heel to toe."""
    mesh = brick((0.23, 0.13, 0.03), (5, 4, 2))
    sole = Sole(mesh, MaterialBlock("neoprene").material())
    force = np.column_stack([0 * TIMES + 5.0, 0 * TIMES, 300.0 + 500.0 * TIMES])
    zmp = np.column_stack([np.linspace(-0.04, 0.04, 9), 0 * TIMES + 0.01])
    load = Load(TIMES, force, zmp)
    start = Start(
        np.array([-0.115, 0.0, -0.03]), np.array([-0.115, 0.0, 0.0]), 0.0
    )
    law = ContactLaw(0.8, sole.penalty)
    history = simulate(ContactSolver.of(sole, law), load, start)
    assert history.failed_steps == 0
    return mesh, load, history


@pytest.fixture
def folder(tmp_path, step):
    (tmp_path / "summary.json").write_text('{"name": "small", "c_rot": 1}')
    mesh, load, history = step
    write_history(tmp_path / HISTORY, mesh, load.times, history)
    return tmp_path


def test_force_and_pressure_are_those_of_the_load(step):
    mesh, load, history = step
    motion = SoleMotion.of("small", mesh, load.times, history)
    np.testing.assert_allclose(motion.force.sum(axis=1), load.force, atol=1e-6)
    np.testing.assert_allclose(
        motion.ground.zero_moment_point(motion.force, motion.places)[:, :2],
        load.zmp,
        atol=1e-7,
    )
    # Pressure times the bottom's areas is the force again, in kPa and m².
    faces = mesh.contact_faces
    faces = faces[np.isclose(mesh.nodes[faces, 2], -0.03).all(axis=1)]
    x = mesh.nodes[faces]
    area = 0.5 * np.linalg.norm(
        np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1
    )
    at = np.searchsorted(motion.surface, faces)
    pressed = motion.pressure()[:, at].mean(axis=2) @ area
    np.testing.assert_allclose(1e3 * pressed, load.force[:, 2], rtol=1e-6)


def test_sides_that_may_touch_are_read_again(tmp_path):
    """Once the sole rolls far all its bare nodes are followed."""
    mesh = brick((0.1, 0.06, 0.03), (3, 2, 2)).touching_everywhere()
    sole = Sole(mesh, MaterialBlock("neoprene").material())
    force = np.tile([0.0, 0.0, 100.0], (3, 1))
    load = Load(0.1 * np.arange(3.0), force, np.zeros((3, 2)))
    start = Start(np.zeros(3), np.zeros(3), 0.0)
    solver = ContactSolver.of(sole, ContactLaw(0.8, sole.penalty))
    history = simulate(solver, load, start)
    write_history(tmp_path / HISTORY, mesh, load.times, history)
    motion = SoleMotion.read(tmp_path / HISTORY, "small")
    np.testing.assert_array_equal(motion.mesh.contact, mesh.contact)
    np.testing.assert_array_equal(motion.mesh.fixed, mesh.fixed)
    assert motion.surface_places().shape[1] == len(motion.surface)
    own = SoleMotion.of("small", mesh, load.times, history)
    np.testing.assert_allclose(motion.pressure(), own.pressure())


def test_surface_lies_on_the_ground_and_under_the_foot(step):
    mesh, load, history = step
    motion = SoleMotion.of("small", mesh, load.times, history)
    places = motion.surface_places()
    assert places[:, :, 2].min() > -1e-9
    pressed = motion.pressure() > 1.0
    assert np.abs(places[pressed][:, 2]).max() < 1e-9
    fixed = np.isin(motion.surface, mesh.fixed)
    rest = mesh.nodes[motion.surface[fixed]]
    expected = history.O[4] + rest @ history.R[4].T
    np.testing.assert_allclose(places[4, fixed], expected, atol=1e-12)


def test_history_on_disk_is_the_same_motion(folder, step):
    mesh, load, history = step
    read = SoleMotion.read(folder / HISTORY, "small")
    made = SoleMotion.of("small", mesh, load.times, history)
    np.testing.assert_array_equal(read.surface_places(), made.surface_places())
    np.testing.assert_array_equal(read.pressure(), made.pressure())


def test_page_holds_every_sole(folder, tmp_path):
    before = tmp_path / FIRST_HISTORY
    before.write_bytes((folder / HISTORY).read_bytes())
    page = tmp_path / "page.html"
    assert main(["view", str(folder), "--out", str(page)]) == 0
    assert clip_titles(page) == {
        "small": ["small: optimised", "small: initial shape"]
    }
    assert page.stat().st_size < 20e6
    assert network_addresses(page) == []
    found = player_data(page)
    first, second = found["clips"]
    assert list(first["surfaces"]) == ["/sole/0"]
    assert list(second["surfaces"]) == ["/sole/1"]
    values = first["surfaces"]["/sole/0"]["values"]
    assert values.max() == 65535
    assert values.min() == 0
    force = first["arrows"]["ground"].reshape(-1, 6)
    np.testing.assert_allclose(force[0, 3:], [5.0, 0.0, 300.0], atol=1e-4)


def test_page_repeats_itself(folder, tmp_path):
    for name in ("a", "b"):
        replay_soles(folder, tmp_path / f"{name}.html")
    page = (tmp_path / "a.html").read_bytes()
    assert page == (tmp_path / "b.html").read_bytes()


def test_failed_samples_are_left_out(folder, step):
    mesh, load, history = step
    K_c = history.K_c.copy()
    history.K_c[3] = np.nan
    write_history(folder / HISTORY, mesh, load.times, history)
    history.K_c[:] = np.nan
    write_history(folder / "none.npz", mesh, load.times, history)
    history.K_c[:] = K_c
    assert len(SoleMotion.read(folder / HISTORY, "").times) == 8
    assert SoleMotion.read(folder / "none.npz", "") is None


def test_folder_without_soles_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no history"):
        replay_soles(tmp_path, tmp_path / "page.html")


def test_damaged_history_is_refused(folder):
    with np.load(folder / HISTORY) as arrays:
        data = dict(arrays)
    del data["place_W"]
    np.savez(folder / HISTORY, **data)
    with pytest.raises(InputError, match="place_W"):
        replay_soles(folder, folder / "page.html")
    (folder / HISTORY).write_bytes(b"PK nothing")
    with pytest.raises(InputError, match=": is damaged"):
        replay_soles(folder, folder / "page.html")


def test_damaged_checks_are_told_with_their_file(folder, tmp_path):
    (folder / "summary.json").write_text('{"name": "small", "checks": "x"}')
    with pytest.raises(InputError, match=r"summary\.json: checks are not as"):
        replay_soles(folder, tmp_path / "page.html")
