"""Small beside finite strain: every number of the table by a second way."""

import csv
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.soles import finite_strain as module
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.contact.newton import Convergence, State, Target
from drake_exo.soles.elasticity import Sole
from drake_exo.soles.finite_strain import (
    _enter,
    compare_strains,
    follow,
    from_json,
    table,
    write_table,
)
from drake_exo.soles.loads import Load
from drake_exo.soles.results import Step


@pytest.fixture(scope="module")
def case():
    """Five samples of heel strike, of fifty; sideways and forward forces."""
    rows = ["time_s,force_x_n,force_y_n,force_z_n,zmp_x_m,zmp_y_m"]
    for k in range(50):
        rows.append(f"{0.02 * k},{40 - k},{5 + 0.1 * k},{300 + 5 * k},"
                    f"{-0.06 + 0.002 * k},{0.01 + 2e-4 * k}")  # fmt: skip
    return rows


@pytest.fixture(scope="module")
def compared(case, tmp_path_factory):
    folder = tmp_path_factory.mktemp("strain")
    (folder / "load.csv").write_text("\n".join(case))
    text = EXAMPLE[: EXAMPLE.index("load:")] + "load: {csv: {file: load.csv}}\n"
    text = text.replace("neoprene}", "neoprene, youngs_modulus_pa: 6.0e5}")
    (folder / "case.yaml").write_text(text)
    setup = Case.read(folder / "case.yaml")
    said = []
    return setup, compare_strains(setup, said.append), said


@pytest.mark.slow
def test_several_loads_count_by_their_weights(compared):
    """The same step twice is that step."""
    setup, found, _ = compared
    twice = Load.one_after_another([setup.load] * 2, [1.0, 3.0])
    again = compare_strains(replace(setup, load=twice))
    assert again["heel_strike_samples"] == 2 * found["heel_strike_samples"]
    # Numbered as in steps.csv: the second heel strike begins at the 51st.
    assert [row["sample"] for row in again["samples"]] == [1, 51, 55]
    for key in ("c_tr_small", "c_tr_finite"):
        assert again[key] == pytest.approx(found[key], rel=1e-6)


@pytest.mark.slow
def test_each_sample_is_that_of_both_simulations(compared):
    setup, found, said = compared
    assert found["heel_strike_samples"] == found["converged_samples"] == 5
    assert found["failures"] == []
    assert said == [f"finite strain, {k} of 5 samples" for k in range(1, 6)]
    assert [row["sample"] for row in found["samples"]] == [1, 3, 5]
    mesh = setup.mesh.touching_everywhere()
    sole = Sole(mesh, setup.settings.material.material(), "linear")
    strike = setup.load.at(np.arange(5))
    given = replace(setup, mesh=mesh, load=strike)
    small = Step.of(given, sole)
    law = small.law
    finite = follow(sole, law, strike, setup.start)

    def tr(K):
        return np.linalg.svd(K[:3, :3])[1].max()

    for key, K in (("small", small.stiffness), ("finite", finite.K_c)):
        wanted = sum(tr(block) for block in K)
        assert found[f"c_tr_{key}"] == pytest.approx(wanted, rel=1e-5)
    for row, q in zip(found["samples"], (0, 2, 4), strict=True):
        assert row["converged"] is True and row["reached"] == 1.0
        state = finite.states[q]
        for key, K, R in (
            ("small", small.stiffness[q], small.rotation[q]),
            ("finite", finite.K_c[q], state.R),
        ):
            least = np.linalg.svd(K[3:, 3:])[1].min()
            scale = np.diag([1, 1, 1, 20, 20, 20])
            margin = np.linalg.eigvalsh(-scale @ (K + K.T) @ scale / 2).min()
            tilt = np.degrees(np.arccos(R[2, 2]))
            for name, wanted in (
                ("sigma_max_tr_n_per_m", tr(K)),
                ("sigma_min_rot_nm_per_rad", least),
                ("stability_n_per_m", margin),
                ("tilt_deg", tilt),
            ):
                assert row[f"{name}_{key}"] == pytest.approx(wanted, rel=1e-4)
        # Stretches of an element's edges: x' = F x.
        x = mesh.nodes[mesh.tets]
        rest = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
        y = (mesh.nodes + state.u)[mesh.tets]
        bent = (y[:, 1:] - y[:, :1]).transpose(0, 2, 1)
        stretch = np.linalg.svd(bent @ np.linalg.inv(rest))[1]
        assert row["largest_stretch_finite"] == pytest.approx(stretch.max())
        assert row["least_stretch_finite"] == pytest.approx(stretch.min())
        f = small.history.F[q] @ small.rotation[q]
        y = (mesh.nodes + sole.displacement(f))[mesh.tets]
        H = (y[:, 1:] - y[:, :1]).transpose(0, 2, 1) @ np.linalg.inv(rest)
        eps = np.linalg.eigvalsh((H + H.transpose(0, 2, 1)) / 2) - 1
        assert row["largest_stretch_small"] == pytest.approx(1 + eps.max())
        assert row["least_stretch_small"] == pytest.approx(1 + eps.min())
        assert row["largest_stretch_finite"] > 1.005


def test_the_table_says_each_number_in_its_column(compared, tmp_path):
    _, found, _ = compared
    text = write_table(tmp_path, {"one": found})
    lines = [line.split() for line in text.splitlines() if line[:4] == "one "]
    keys = ("sigma_max_tr_n_per_m", "sigma_min_rot_nm_per_rad", "tilt_deg",
            "largest_stretch", "least_stretch")  # fmt: skip
    for words, row in zip(lines, found["samples"], strict=True):
        assert int(words[1]) == row["sample"]
        wanted = [
            row[f"{key}_{k}"] for key in keys for k in ("small", "finite")
        ]
        np.testing.assert_allclose(
            [float(word) for word in words[2:]], wanted, rtol=6e-3, atol=0.051
        )
    assert f"{found['c_tr_small']:.3g} in small" in text
    with open(tmp_path / "finite_strain.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    for written, row in zip(rows, found["samples"], strict=True):
        assert written.pop("sole") == "one"
        for key, value in row.items():
            if isinstance(value, float):
                assert float(written[key]) == pytest.approx(value, rel=1e-9)
    nothing = from_json(found | {"c_tr_finite": None}, "s.json")
    assert np.isnan(nothing["c_tr_finite"])
    assert nothing["samples"] == found["samples"]


def _fake(monkeypatch, fails, ways):
    """Newton that fails for some parts of the load, and ways that end."""
    asked = []

    class Solver:
        law = ground = None

        def solve(self, state, aim):
            part = float(aim.force[2]) / 100
            asked.append((part, float(aim.moment)))
            return f"at {part}", Convergence(part not in fails, 3, 0.0)

    def lead(solver, state, before, target):
        part = float(before.force[2]) / 100
        way = ways.get(part, 1.0)
        report = Convergence(way == 1.0, 4, 0.0, reached=way)
        return f"{state} on", report

    def first_step(small, aim, largest):
        assert largest == pytest.approx(500 * aim.force[2] / 100)
        return State(np.zeros((1, 3)), np.zeros(3), np.eye(3)), Convergence(
            True, 2, 0.0
        )

    monkeypatch.setattr(
        module, "ContactSolver", SimpleNamespace(of=lambda *_, **__: None)
    )
    monkeypatch.setattr(module, "first_step", first_step)
    monkeypatch.setattr(module, "lead", lead)
    target = Target(np.array([0, 0, 100.0]), np.zeros(2), "r", 8.0)
    sole = SimpleNamespace(displacement=lambda f: 0 * f)
    found = _enter(sole, Solver(), target, 500.0, None)
    return asked, found


def test_the_first_sample_is_entered_at_a_part_of_its_load(monkeypatch):
    asked, (state, report) = _fake(monkeypatch, (1.0, 0.5), {})
    assert asked == [(1.0, 8.0), (0.5, 4.0), (0.25, 2.0)]
    assert (state, report.reached) == ("at 0.25 on", 1.0)
    assert report.converged


def test_of_ways_that_end_the_longest_is_kept(monkeypatch):
    """0.25 and 0.8 of the rest; 0.1 and 0.9 of the rest: 0.85 and 0.91."""
    ways = {0.5: 0.2, 0.25: 0.8, 0.1: 0.9, 0.04: 0.1}
    asked, (state, report) = _fake(monkeypatch, (1.0,), ways)
    assert [part for part, _ in asked] == [1.0, 0.5, 0.25, 0.1, 0.04]
    assert state == "at 0.1 on" and not report.converged
    assert report.reached == pytest.approx(0.91)


def test_words_stand_over_their_numbers(compared):
    _, under, _, first, *_ = table({"one": compared[1]}).splitlines()
    ends = [m.end() for m in re.finditer(r"\S+", first)][2:]
    over = [(m.group(), m.end()) for m in re.finditer(r"\S+", under)]
    assert over == list(zip(5 * ["small", "finite"], ends, strict=True))


def test_samples_that_fail_are_numbered_as_of_the_load():
    finite = SimpleNamespace(
        converged=np.array([True, False, False]),
        reports=[
            SimpleNamespace(message=m, reached=way)
            for m, way in zip("abc", (1.0, 0.3, 0.0), strict=True)
        ],
    )
    assert module._failures(finite, np.array([0, 1, 50])) == [
        {"sample": 2, "reached": 0.3, "message": "b"},
        {"sample": 51, "reached": 0.0, "message": "c"},
    ]
    assert "sample" in table({})
