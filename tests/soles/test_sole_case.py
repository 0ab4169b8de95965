"""Case files, loads and the command, bad input included."""

import json
import re
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import meshio
import numpy as np
import pytest

from drake_exo import cli
from drake_exo.errors import InputError
from drake_exo.files.output import Progress
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.load_blocks import (
    Constant,
    ForcePlate,
    Playback,
    share_double_support,
)
from drake_exo.soles.mesh import brick
from drake_exo.soles.results import sole_samples

GOOD = """
name: small
mesh:
  brick: {size_m: [0.23, 0.13, 0.03], divisions: [4, 3, 2]}
material: {name: neoprene}
contact: {friction: 0.8}
load:
  csv: {file: load.csv}
"""
ROWS = """time_s,force_x_n,force_y_n,force_z_n,zmp_x_m,zmp_y_m
0.0,1,0,200,-0.05,0.0
0.1,0,0,400,0.0,0.0
0.2,0,0,200,0.05,0.01
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "case.yaml").write_text(GOOD)
    (tmp_path / "load.csv").write_text(ROWS)
    return tmp_path


def _run(folder, *more):
    return cli.main(
        ["sole", "simulate", str(folder / "case.yaml"),
         "--out", str(folder / "out"), *more]
    )  # fmt: skip


@pytest.mark.slow
def test_a_case_runs_and_leaves_its_results(folder, capsys, monkeypatch):
    every = partial(Progress, interval_seconds=0.0)
    monkeypatch.setattr("drake_exo.cli.sole._progress", every)
    assert _run(folder) == 0
    reading, *said = capsys.readouterr().out.splitlines()
    assert "case.yaml: reading and meshing (" in reading
    assert [line.partition(" (")[0] for line in said[1:5]] == [
        *(f"small: {q}/3, samples" for q in (1, 2, 3)), "small: 3/3, pictures",
    ]  # fmt: skip
    numbers = json.loads((folder / "out" / "summary.json").read_text())
    for key in ("c_tr", "c_rot", "c", "steps", "failed_steps",
                "contact_nodes", "tets", "simulation_seconds"):  # fmt: skip
        assert key in numbers
    assert said[0] == f"{numbers['name']}: {numbers['tets']} tets, 3 samples"
    assert (numbers["steps"], numbers["failed_steps"]) == (3, 0)
    assert numbers["complementarity"] < 1e-10
    page = folder / "out" / "animation.html"
    text = page.read_text(encoding="utf-8")
    assert page.stat().st_size < 20e6
    assert "handle_command_bytearray" in text
    assert 'src="' not in text  # nothing is fetched
    with np.load(folder / "out" / "history.npz") as arrays:
        assert arrays["force_W"].shape[0] == 3
    for name in ("load", "stiffness", "pose", "pressure"):
        assert (folder / "out" / f"{name}.png").stat().st_size > 5000


@pytest.mark.parametrize(
    ("words", "slow", "said"),
    [
        (["simulate", "case.yaml"], "soles.Case.read",
         "case.yaml: reading and meshing ("),
        (["study"], "paper.Study.read", "study: reading and meshing ("),
        (["optimize", "case.yaml"], "soles.Case.optimize",
         "small: searching ("),
        (["reduce", "law.yaml"], "soles.sole_samples", "law.yaml: fitting 4 "),
    ],
)  # fmt: skip
def test_what_is_slow_is_told(tmp_path, capsys, monkeypatch, words, slow, said):
    """Meshing a surface and fitting spheres take some seconds."""

    def idle(*given):
        time.sleep(0.1)
        raise InputError("slow")

    monkeypatch.setattr("drake_exo.cli.sole._QUIET", 0.02)
    monkeypatch.setattr(f"drake_exo.cli.sole.{slow}", idle)
    if words[0] == "reduce":
        monkeypatch.setattr(f"drake_exo.cli.sole.{slow}", lambda source: None)
        monkeypatch.setattr("drake_exo.contact.reduction.reduce_sole", idle)
    (tmp_path / "load.csv").write_text(ROWS)
    (tmp_path / "case.yaml").write_text(GOOD)
    monkeypatch.chdir(tmp_path)
    out = ["--out", str(tmp_path / "out.yaml")]
    assert cli.main(["sole", *words, *out]) == 2
    assert f"\n{said}" in f"\n{capsys.readouterr().out}"


@pytest.mark.slow
def test_results_are_not_overwritten_and_repeat_exactly(folder, capsys):
    assert _run(folder) == 0
    names = ("steps.csv", "animation.html", "stiffness.png")
    first = [(folder / "out" / n).read_bytes() for n in names]
    assert _run(folder) == 2
    assert "--force" in capsys.readouterr().err
    assert _run(folder, "--force") == 0
    assert [(folder / "out" / n).read_bytes() for n in names] == first


BAD = {
    "zmp outside": (("load.csv", "-0.05,0.0", "-0.25,0.0"), "outside the sole"),
    "no force": (("load.csv", "0,0,400", "0,0,0"), "vertical force"),
    "pull": (("load.csv", "0,0,400", "0,0,-3"), "vertical force"),
    "same time": (("load.csv", "0.2,0,0", "0.1,0,0"), "two samples at one"),
    "not a number": (("load.csv", "400", "x"), "text among numbers"),
    "nan": (("load.csv", "400", "nan"), "NaN"),
    "nu": (
        ("case.yaml", "neoprene}", "neoprene, poissons_ratio: 0.5}"),
        "poissons_ratio",
    ),
    "density": (
        ("case.yaml", "neoprene}", "neoprene, density_kg_per_m3: 1.23}"),
        "density_kg_per_m3",
    ),
    "stiff": (
        ("case.yaml", "neoprene}", "neoprene, youngs_modulus_pa: 1.0e+100}"),
        "youngs_modulus_pa",
    ),
    "mu below": (("case.yaml", "0.8", "-0.1"), "friction"),
    "mu zero": (("case.yaml", "0.8", "0.0"), "friction"),
    "key": (("case.yaml", "friction:", "fricton:"), "fricton"),
    "two loads": (
        ("case.yaml", "load:", "load:\n  constant: {force_n: [0, 0, 1], "
         "zmp_m: [0, 0]}"), "exactly one",
    ),
    "material": (("case.yaml", "neoprene", "cheese"), "cheese"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_sentence_and_exit_code_2(folder, capsys, name):
    (file, old, new), message = BAD[name]
    path = folder / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    assert _run(folder) == 2
    err = capsys.readouterr().err
    assert message in err
    assert "Traceback" not in err
    assert err.count("\n") == 1
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[4, 3, 2]", "[4, 0, 2]", r"brick.divisions\[1\] is 0, .* least 1$"),
        (
            "[0.23, 0.13, 0.03]",
            "[230, 130, 1.0e-9]",
            r"size_m\[2\] is 1.0e-9, .* at least 0.001 m$",
        ),
        ("iterations: 5", "samples: 0", "samples is 0"),
        (
            "iterations: 5",
            "divisions: [0, 1, 1]",
            r"stages.*divisions\[0\] is 0",
        ),
        ("kappa: 0.2", "kappa: 1.1", r"kappa is 1.1, but must be at most 1"),
        ("layer_m: 1.0e-4", "layer_m: 1", r"layer_m is 1, .* most 0.01 m"),
        ("starts: 1", "strain: 30", "strain is 30"),
        ("load:", "start: {yaw_rad: -5.7e+1}\nload:", "yaw_rad"),
        ("neoprene}", "neoprene, youngs_modulus_pa: 5}", "at least 1000 Pa"),
    ],
)
def test_numbers_out_of_bounds_are_refused_by_key(old, new, words):
    assert old in EXAMPLE
    with pytest.raises(InputError, match=words):
        Case.from_text(EXAMPLE.replace(old, new))


def test_an_error_of_one_of_several_loads_says_which():
    """Of a single load there is nothing to say."""
    one = EXAMPLE[EXAMPLE.index("  constant:") : EXAMPLE.index("optimize:")]
    one = one.strip().replace("0.02, 0.01", "0.2, 0.01")
    for load, words in (
        (f"loads:\n  - pattern: {{}}\n  - {one}\n", r"^loads\[1\]: constant l"),
        (f"load:\n  {one}\n", "^constant load: the ZMP is outside"),
    ):
        head, rest = EXAMPLE.split("load:\n")
        text = head + load + rest[rest.index("optimize:") :]
        with pytest.raises(InputError, match=words):
            Case.from_text(text)


def test_keys_of_a_surface_are_refused_beside_tetrahedra():
    head, rest = EXAMPLE.split("  brick:")
    text = f"{head}  file: sole.vtk\n  unit: mm\n{rest.partition(chr(10))[2]}"
    with pytest.raises(InputError, match=r"unit is for a surface \(\.stl"):
        Case.from_text(text)


@pytest.mark.parametrize("fault", ["inverted", "unconnected", "no top"])
def test_bad_mesh_is_exit_code_2(folder, capsys, fault):
    mesh = brick((0.23, 0.13, 0.03), (3, 2, 2))
    nodes, tets = mesh.nodes, mesh.tets.copy()
    if fault == "inverted":
        tets[5] = tets[5][[1, 0, 2, 3]]
    elif fault == "unconnected":
        tets = np.concatenate([tets, tets + len(nodes)])
        nodes = np.concatenate([nodes, nodes + np.eye(3)[0]])
    else:
        nodes = nodes + [[0, 0, 0.01]] * np.abs(nodes[:, :1]) ** 0.5
    path = folder / "mesh.vtk"
    meshio.Mesh(nodes, [("tetra", tets)]).write(path)
    assert _run(folder, "--mesh", str(path)) == 2
    words = {"inverted": "inverted", "unconnected": "unconnected",
             "no top": "no face is glued to the foot"}  # fmt: skip
    assert words[fault] in capsys.readouterr().err


def test_missing_files_are_exit_code_2(folder, capsys):
    assert _run(folder, "--mesh", str(folder / "none.msh")) == 2
    (folder / "load.csv").unlink()
    assert _run(folder) == 2
    assert "check the path" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "c_tr", "c_rot"),
    [
        ("hrp4_neoprene", 4.33e6, 2.04e5),
        ("hrp4_butyl", 6.03e6, 2.84e5),
        ("hrp4_straight", 9.67e6, 3.77e5),
    ],
)
def test_authors_step(data_root, name, c_tr, c_rot):
    cases = Path(__file__).parents[1] / "cases"
    step = Case.read(cases / f"{name}.yaml", data_root).simulate()
    assert len(step.times) == 219
    assert step.failed_steps == 0
    assert step.c_tr == pytest.approx(c_tr, rel=5e-3)
    assert step.c_rot == pytest.approx(c_rot, rel=5e-3)


def test_force_plate_is_turned_upright(data_root):
    cases = Path(__file__).parents[1] / "cases"
    load = Case.read(cases / "opencap_walking.yaml", data_root).load
    assert (load.force[:, 2] > 0).all()
    assert np.ptp(load.zmp[:, 0]) == pytest.approx(0.268, abs=0.03)
    other = ForcePlate(
        "opencap_subject4/ID/walking1_grf.mot",
        *("ground_force_7", 0.54, 1.21, (0.0, 0.0)),
    )
    with pytest.raises(InputError, match="ground_force_7"):
        other.load(data_root)


def test_playback_shares_double_support_continuously(data_root):
    path = data_root / "soft_sole_hrp4" / "trajectory" / "hrp4_playback.txt"
    left = Playback(path, "left", 1, 43.0).load(data_root)
    step = np.abs(np.diff(left.force[:, 2])).max()
    assert step < 0.05 * left.force[:, 2].max()
    assert np.abs(np.diff(left.zmp, axis=0)).max() < 2e-3
    middle = left.force[len(left.times) // 2, 2]
    assert middle == pytest.approx(43 * 9.81)


def test_a_foot_of_a_playback_is_the_other_s_mirror_image(tmp_path):
    """From its own sole's centre: 15 mm before, 11 mm outside its ankle."""
    phase = np.repeat([1, 0, 2, 0, 1, 0, 2, 0, 1], 6)
    n = len(phase)
    rng = np.random.default_rng(4)
    one = np.zeros((n, 37))
    one[:, 0] = phase
    one[:, 1:3] = np.column_stack([0.01 * np.arange(n), 0.09 * (phase == 1)])
    one[:, 10:13] = rng.normal(0.0, 0.3, (n, 3))
    one[:, 13:15], one[:, 22:24] = (0.2, 0.1), (0.3, -0.08)
    other, y = one.copy(), [2, 11, 14, 23]
    other[:, 0] = np.array([0, 2, 1])[phase]
    other[:, 13:15], other[:, 22:24] = one[:, 22:24], one[:, 13:15]
    other[:, y] *= -1.0
    for name, table in (("one", one), ("other", other)):
        np.savetxt(tmp_path / name, table)
    left = Playback("one", "left", 0, 50.0).load(tmp_path)
    right = Playback("other", "right", 0, 50.0).load(tmp_path)
    np.testing.assert_allclose(right.zmp, left.zmp * [1.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(right.force, left.force * [1.0, -1.0, 1.0])
    alone = np.flatnonzero(phase == 1)[6:12]
    k = np.searchsorted(left.times, 0.005 * alone - 1e-9)
    np.testing.assert_allclose(
        left.zmp[k], one[alone, 1:3] - [0.215, 0.111], atol=1e-9
    )
    needed = 50.0 * (one[alone, 10:13] + [0.0, 0.0, 9.81])
    np.testing.assert_allclose(left.force[k], needed)


def test_double_support_shares_add_up():
    phase = np.array([1] * 5 + [0] * 10 + [2] * 5)
    s = np.concatenate([np.zeros(5), np.linspace(0, 1, 10), np.ones(5)])
    zmp = np.stack([0.2 * s, 0.1 - 0.2 * s + 0.02 * np.sin(np.pi * s)], 1)
    a, za = share_double_support(zmp, phase, 1)
    b, zb = share_double_support(zmp, phase, 2)
    np.testing.assert_allclose(a + b, 1.0)
    total = a[:, None] * za + b[:, None] * zb
    np.testing.assert_allclose(total, zmp, atol=1e-15)


def test_a_turned_plate_sees_a_turned_load():
    load = Constant((10.0, 0.0, 100.0), (1.0, 2.0)).load()
    seen = load.placed([1.0, 1.0], np.pi / 2)
    np.testing.assert_allclose(seen.zmp[0], [1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(seen.force[0], [0.0, -10.0, 100.0], atol=1e-14)


@pytest.mark.slow
def test_soles_never_load_systems_nor_the_exoskeleton_half():
    code = (
        "import sys, pkgutil, importlib, drake_exo.soles as s\n"
        "for m in pkgutil.walk_packages(s.__path__, 'drake_exo.soles.'):\n"
        "    importlib.import_module(m.name)\n"
        "bad = [m for m in sys.modules if m.startswith(("
        "'pydrake.systems', 'pydrake.multibody', 'drake_exo.model', "
        "'drake_exo.contact', 'drake_exo.calibration', 'drake_exo.cli', "
        "'drake_exo.collocation', 'drake_exo.measurement', "
        "'drake_exo.report'))]\n"
        "assert not bad, bad\n"
        "assert 'drake_exo.soles.simulation' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("iterations", "why"),
    [
        (-1, "is -1, but must be at least 0"),
        (2.5, "must be a whole number, but is '2.5'"),
        ("a", "must be a whole number, but is 'a'"),
    ],
)
def test_iterations_are_a_whole_number(iterations, why):
    case = Case.from_text(EXAMPLE)
    said = f"{case.name}: optimize: stages[0].iterations {why}"
    with pytest.raises(InputError, match=f"^{re.escape(said)}$"):
        case.with_iterations(iterations)


def test_what_a_case_asks_for_in_vain_names_its_file(tmp_path):
    path = tmp_path / "case.yaml"
    path.write_text(EXAMPLE.replace("10, 0, 400", "10, 0, -4"))
    with pytest.raises(
        InputError, match=r"case\.yaml: constant load: .* above"
    ):
        Case.read(path)


def test_a_notebook_shows_no_arrays():
    case = Case.from_text(EXAMPLE)
    mesh, load = "TetMesh(60 nodes, 144 tets)", repr(case.load)
    assert load == "Load('constant load', 5 samples, up to 400.0 N vertically)"
    assert repr(case.mesh) == mesh
    assert repr(case) == f"Case('example', {mesh}, {load})"
    samples = sole_samples(case.simulate())
    assert repr(samples) == "SoleSamples(5 samples, up to 400.0 N)"


def test_news_of_a_search_are_not_hidden_by_lines_that_say_it_goes_on(
    tmp_path, capsys, monkeypatch
):
    """Most iterations come while no line is due; the newest is then told."""

    def search(case, out, say, *given):
        for iteration in range(10):
            say(f"iteration {iteration}")
            time.sleep(0.05)
        raise InputError("slow")

    monkeypatch.setattr("drake_exo.cli.sole._QUIET", 0.02)
    monkeypatch.setattr("drake_exo.cli.sole.soles.Case.optimize", search)
    (tmp_path / "load.csv").write_text(ROWS)
    (tmp_path / "case.yaml").write_text(GOOD)
    where = [str(tmp_path / "case.yaml"), "--out", str(tmp_path / "out")]
    assert cli.main(["sole", "optimize", *where]) == 2
    told = capsys.readouterr().out
    assert sum(f"iteration {i}" in told for i in range(10)) >= 8


def test_the_text_of_a_case_is_text():
    with pytest.raises(
        InputError, match=r"text is \{'name': 'a'\}; give a str"
    ):
        Case.from_text({"name": "a"})
