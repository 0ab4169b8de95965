"""What a design tells, number by number, of a program that nothing solved."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from worn import as_guessed, bands_of, norm_of
from worn import wearer as worn

from drake_exo import designed, designing
from drake_exo.calibration.design import (
    DesignProblem,
    DesignResult,
    works,
)
from drake_exo.calibration.design_variables import Variable
from drake_exo.calibration.settings import (
    CuffFreedom,
    DesignLimits,
    DesignSettings,
    DriveLimits,
    Population,
    Solver,
)
from drake_exo.cli import design as command
from drake_exo.contact.strap import Design
from drake_exo.designed import Designed, Moved
from drake_exo.designing import pareto_front
from drake_exo.model.plant import nominal_model

CUFFS = ("shank", "thigh", "pelvis")
AREA_M2 = 0.02
SETTINGS = DesignSettings(
    points=1,
    solver=Solver(10.0),
    limits=DesignLimits(migration_mm=1.0),
    cuffs=dict.fromkeys(
        CUFFS,
        CuffFreedom(along_m=(-0.02, 0.05), area=(0.5, 2.0), area_m2=AREA_M2),
    ),
)
DIFFER = {"first": {"thigh": 1.5}, "second": {"shank": 0.8}}
# The design: one cuff larger, one moved far, one behind a strap.
VALUES = {
    "thigh.area": 1.6,
    "pelvis.along_m": 0.04,
    "shank.strap_normal_n_m": 1e-4,
    "exo_knee.factor_at_0_deg": 1.2,
}


@pytest.fixture(scope="module")
def made():
    """Two wearers, who move on the design as they do today."""
    model = nominal_model("coupled")
    wearers = [
        replace(worn(model, name, duration), differ=DIFFER[name])
        for name, duration in (("first", 1.5), ("second", 2.0))
    ]
    today = as_guessed(DesignProblem(wearers, SETTINGS, held=True))
    problem = DesignProblem(wearers, SETTINGS, today=today)
    guess = problem.guess(VALUES)
    problem.guess = lambda: guess
    found = as_guessed(problem)
    before, after = (
        {
            w.name: [
                Moved(t, None, own)
                for t, own in zip(
                    result.wearers[w.name].trials, w.trials, strict=True
                )
            ]
            for w in wearers
        }
        for result in (today, found)
    )
    return Designed(SETTINGS, today, found, before, after)


@pytest.fixture(scope="module")
def felt(made):
    return made.felt()


@pytest.fixture
def told(made, felt, monkeypatch):
    """The same, with what is felt told at once."""
    monkeypatch.setattr(Designed, "felt", lambda *_: felt)
    return made


def test_a_design_shows_what_it_found(made):
    """Not its settings; of a failed solve the status alone."""
    head, *rows = repr(made).splitlines()
    norms = f"{made.today.norm_n:.1f} N today, {made.found.norm_n:.1f} N"
    status = made.solution.status
    assert head == f"Designed({status!r}), norm of forces {norms}"
    free = {r["name"]: r for r in made.variables()}
    assert len(rows) == len(free)
    for row in rows:
        name, value, unit = row.split(maxsplit=2)
        assert float(value) == pytest.approx(free[name]["value"], rel=1e-3)
        assert unit == free[name]["unit"]
    failed = SimpleNamespace(solution=SimpleNamespace(status="a", success=0))
    assert repr(replace(made, found=failed)) == "Designed('a')"


def trials(made, when):
    return {n: m[0].trial for n, m in getattr(made, when).items()}


@pytest.mark.slow
def test_values_of_the_design_are_told(made):
    rows = {r["name"]: r for r in made.variables()}
    assert made.found.values["thigh.area"] == pytest.approx(1.6)
    area = rows["thigh.area"]
    assert (area["value"], area["today"]) == (pytest.approx(1.6), 1.0)
    assert (area["lower"], area["upper"], area["unit"]) == (0.5, 2.0, "1")
    assert not area["extrapolated"]
    assert rows["pelvis.along_m"]["extrapolated"]  # by more than 3 cm
    assert not rows["shank.along_m"]["extrapolated"]
    strap = rows["shank.strap_normal_n_m"]
    assert strap["strap"] == pytest.approx(1e4)
    assert strap["strap_unit"] == "N/m"
    assert rows["shank.strap_rotational_nm_rad"]["strap_unit"] == "N m/rad"
    assert rows["shank.strap_rotational_nm_rad"]["strap"] is None
    # Held ones are no choice.
    assert "thigh.across_m" not in rows


@pytest.mark.slow
def test_slopes_are_for_a_step_of_typical_size(made, monkeypatch):
    told = {v.name: 3.0 for v in made.found.problem.design}
    settings = SimpleNamespace(settings=SimpleNamespace(weight=0.5))
    today = SimpleNamespace(slopes=lambda: told, problem=settings)
    own = Designed.slopes.func(SimpleNamespace(today=today, found=made.found))
    assert own["thigh.along_m"] == pytest.approx(6.0 * 0.01)
    assert own["thigh.area"] == pytest.approx(6.0 * 0.1)


@pytest.mark.slow
def test_what_is_felt_is_of_the_largest_forces(made, felt):
    """Over both wearers; across the limb as their mats would show it."""
    for row in felt:
        cuff = row["cuff"]
        for when in ("before", "after"):
            own = row[when]
            area = AREA_M2
            if when == "after" and cuff == "thigh":
                area *= 1.6
            normal, shear, moment, rate, means = [], [], [], [], []
            for name, trial in trials(made, when).items():
                force = trial.cuffs[cuff]
                shown = DIFFER[name].get(cuff, 1.0)
                size, steps = shown * np.abs(force.normal), np.diff(trial.times)
                normal.append(size)
                means.append(0.5 * (size[1:] + size[:-1]) @ steps / steps.sum())
                rate.append(shown * np.abs(np.diff(force.normal) / steps).max())
                shear.append(np.abs(force.tangential).max())
                moment.append(np.abs(force.moment).max())
            peak = max(f.max() for f in normal)
            assert own["peak_n"] == pytest.approx(peak)
            assert own["mean_n"] == pytest.approx(np.mean(means))
            assert own["rate_n_s"] == pytest.approx(max(rate))
            assert own["shear_n"] == pytest.approx(max(shear))
            assert own["moment_nm"] == pytest.approx(max(moment))
            # N on m^2 to kPa.
            assert own["pressure_kpa"] == pytest.approx(peak / area / 1000.0)
            contacts = [
                made.worn[name].contact
                if when == "before"
                else made.design.contact(made.worn[name].contact)
                for name in DIFFER
            ]
            bent = [
                1000.0 * np.abs(getattr(t.cuffs[cuff], what)).max() / stiffness
                for what, stiffness in (
                    (
                        "tangential",
                        contacts[0].bushings[cuff].tangential_stiffness,
                    ),
                    ("normal", contacts[0].bushings[cuff].normal_stiffness),
                )
                for t in trials(made, when).values()
            ]
            assert own["migration_mm"] == pytest.approx(max(bent[:2]))
            assert own["deflection_mm"] == pytest.approx(max(bent[2:]))


@pytest.mark.slow
def test_a_cuff_that_is_moved_far_is_named(told):
    assert "pelvis" in told.softened()
    assert "pelvis" in told.beyond()


def test_peaks_are_means_over_wearers(made):
    for cuff, peak in made.peaks.items():
        ratio = [DIFFER[n].get(cuff, 1.0) for n in DIFFER]
        was, now = (
            np.array(
                [
                    np.abs(t.cuffs[cuff].normal).max()
                    for t in trials(made, when).values()
                ]
            )
            for when in ("before", "after")
        )
        assert peak.model_before == pytest.approx(was.mean())
        assert peak.model_after == pytest.approx(now.mean())
        assert peak.today == pytest.approx(np.mean(ratio * was))
        assert peak.forecast_after == pytest.approx(np.mean(ratio * now))
        assert peak.forecast_low == peak.forecast_high == peak.forecast_after
        seen = [
            np.abs(m[0].measured.cuffs[cuff].normal).max()
            for m in made.before.values()
        ]
        assert peak.measured_before == pytest.approx(np.mean(seen))
        assert peak.measured_after is None


def test_bands_are_at_the_largest_force(made):
    """Of mats where there are any, else of the cuff's force."""
    trial = made.after["first"][0].trial
    n = len(trial.times)
    at = int(np.argmax(np.abs(trial.cuffs["thigh"].normal)))
    mats, cuffs = np.zeros(n), np.zeros((n, 3))
    mats[at], cuffs[at] = 4.0, (1.0, 2.0, 3.0)
    for known, width in (({"thigh": mats}, 4.0), ({}, 2.0)):
        bands = bands_of({"thigh": cuffs}, known)
        moved = Moved(trial, bands, trial)
        step = 0.5 * (trial.times[at + 1] - trial.times[at - 1])
        for shown, factor in ((0.5, 1.0), (1.5, 1.5)):
            found = designed._half_widths(moved, "thigh", shown)
            mean = width * step / trial.duration
            np.testing.assert_allclose(
                found[[1, 3]], factor * np.array([width, mean])
            )
    without = replace(trial, cuffs={})
    for nothing in (Moved(without, bands, trial), Moved(trial, None, trial)):
        assert not designed._half_widths(nothing, "thigh", 1.5).any()


@pytest.mark.slow
def test_what_is_felt_has_half_widths(made):
    """Of the trial that bears most; none without bands."""
    assert {row["half_width_95"] for row in made.felt()} == {None}
    after = {}
    for k, (name, (moved,)) in enumerate(made.after.items()):
        n = len(moved.trial.times)
        wide = np.full((n, 3), 1.0 + k) * [1.0, 2.0, 3.0]
        bands = bands_of(dict.fromkeys(CUFFS, wide), {})
        after[name] = [replace(moved, bands=bands)]
    known = replace(made, after=after)
    for row in known.felt():
        cuff, half = row["cuff"], row["half_width_95"]
        peaks = np.array(
            [
                np.abs(t.cuffs[cuff].components).max(axis=0)
                for t in trials(known, "after").values()
            ]
        )
        shown = np.array([DIFFER[n].get(cuff, 1.0) for n in after])
        peaks[:, 1] *= shown
        wide = np.outer([1.0, 2.0], [1.0, 2.0, 3.0])
        wide[:, 1] *= np.maximum(shown, 1.0)
        along, across, moment = wide[peaks.argmax(axis=0), range(3)]
        area = AREA_M2 * (1.6 if cuff == "thigh" else 1.0)
        assert half == pytest.approx(
            {
                "peak_n": across,
                "mean_n": wide[:, 1].mean(),
                "shear_n": along,
                "moment_nm": moment,
                "pressure_kpa": 1e-3 * across / area,
            }
        )
    assert "thigh after ±" in known.table()
    assert "after ±" not in made.table()


def test_support_is_the_work_of_the_device(made):
    """Over the movement of today; measured where torques were."""
    support = made.support
    before, after = (sum(works(r).values()) for r in (made.today, made.found))
    assert support["before"] == pytest.approx(before)
    assert support["after"] == pytest.approx(after)
    assert before != pytest.approx(after, rel=0.01)
    measured = sum(
        np.trapezoid(
            sum(t.moment(j) * t.velocity(j) for j in t.coordinates.device),
            t.times,
        )
        for t in (m[0].measured for m in made.before.values())
    )
    assert support["measured_before"] == pytest.approx(measured)
    assert support["measured_after"] is None


def test_norms_of_wearers_and_of_the_forecast(made):
    own = made.wearers()
    for name, norms in own.items():
        result = made.today.wearers[name]
        was = norm_of(result.trials, SETTINGS, differ=DIFFER[name]).newton
        assert norms["before"] == pytest.approx(was)
        assert norms["after"] != pytest.approx(was)
    # As it was promised, so it is forecast.
    norm = made.found.norm_n
    assert made.forecast_n == pytest.approx(norm)

    def twice(moved):
        cuffs = {
            c: replace(f, normal=2.0 * f.normal, tangential=2.0 * f.tangential)
            for c, f in moved.trial.cuffs.items()
        }
        return replace(moved, trial=replace(moved.trial, cuffs=cuffs))

    more = {n: [twice(m) for m in ms] for n, ms in made.after.items()}
    assert replace(made, after=more).forecast_n == pytest.approx(2.0 * norm)


def _check(found, name):
    return next(c for c in found if c.name == name)


@pytest.mark.slow
def test_checks_hold_the_numbers_of_the_tables(told):
    found = told.checks()
    support = told.support
    check = _check(found, "design.support")
    change = 100.0 * abs(support["after"] - support["before"])
    assert check.value == pytest.approx(change / abs(support["before"]))
    assert (check.limit, check.holds) == (3.0, check.value <= 3.0)
    check = _check(found, "design.forecast")
    assert check.value == pytest.approx(told.found.norm_n)
    assert check.limit == pytest.approx(1.1 * told.found.norm_n)
    assert check.holds
    check = _check(found, "design.better")
    assert check.value == max(p.forecast_after for p in told.peaks.values())
    assert check.limit == max(p.today for p in told.peaks.values())
    far = {c.where: c.value for c in found if c.name == "design.migration"}
    for row in told.felt():
        value = row["after"]["migration_mm"]
        assert (row["cuff"] in far) == (value > 1.02)
    assert far
    (check,) = (
        c for c in found if c.name == "design.extrapolation" and c.value
    )
    assert (check.where, check.limit) == ("pelvis.along_m", 0.03)
    assert check.value == pytest.approx(0.04)
    assert _check(found, "design.attached").holds


def test_a_forecast_may_be_off_by_a_tenth(told, monkeypatch):
    for share, holds in ((1.05, True), (1.15, False)):
        norm = share * told.found.norm_n
        known = property(lambda _, norm=norm: norm)
        monkeypatch.setattr(Designed, "forecast_n", known)
        check = _check(told.checks(), "design.forecast")
        assert check.holds == holds


@pytest.mark.slow
def test_a_migration_at_its_limit_is_within_it(made, felt, monkeypatch):
    """To a fiftieth, like other limits: the forecast is off by a hundredth."""
    most = felt[0]["after"]["migration_mm"]
    for share, told in ((1.0, False), (0.99, False), (0.97, True)):
        limits = DesignLimits(migration_mm=share * most)
        own = replace(made, settings=replace(SETTINGS, limits=limits))
        monkeypatch.setattr(Designed, "felt", lambda *_: felt[:1])
        names = [c.name for c in own.checks()]
        assert ("design.migration" in names) == told


@pytest.mark.slow
def test_every_cuff_has_the_same_limit_on_migration(made, felt, monkeypatch):
    """Whatever other limits it has, and in which order they are told."""
    row = felt[0] | {"after": felt[0]["after"] | {"migration_mm": 6.0}}
    row["before"] = row["before"] | {"moment_nm": 1.0, "shear_n": 2.0}
    monkeypatch.setattr(Designed, "felt", lambda *_: [row, row])
    for most, told in ((7.0, 0), (5.0, 2)):
        limits = DesignLimits(migration_mm=most)
        own = replace(made, settings=replace(SETTINGS, limits=limits))
        found = [c for c in own.checks() if c.name == "design.migration"]
        assert [c.limit for c in found] == [most] * told


@pytest.mark.slow
def test_each_wearer_s_own_limits_are_judged(made, felt):
    """One who bears little may double it unseen beside one who bears much."""
    alone = [made.felt([name]) for name in made.after]
    for row, *own in zip(felt, *alone, strict=True):
        for key in ("peak_n", "shear_n", "moment_nm"):
            values = [r["after"][key] for r in own]
            assert row["after"][key] == pytest.approx(max(values))
            assert min(values) < max(values)


@pytest.mark.slow
def test_a_forecast_beyond_a_limit_is_told(made, felt, monkeypatch):
    """By the limit's own name; one of today's counts from there."""
    row = felt[0]
    now = row["after"]
    row = row | {"before": dict.fromkeys(now, 1.0)}
    monkeypatch.setattr(Designed, "felt", lambda *_: [row])
    free = DesignLimits(moment_factor=None)
    for name, key, unit in (
        ("normal_n", "peak_n", "N"),
        ("pressure_kpa", "pressure_kpa", "kPa"),
        ("mean_n", "mean_n", "N"),
        ("rate_n_s", "rate_n_s", "N/s"),
        ("shear_n", "shear_n", "N"),
        ("shear_factor", "shear_n", "N"),
        ("moment_nm", "moment_nm", "N m"),
        ("moment_factor", "moment_nm", "N m"),
    ):
        for share, beyond in ((0.99, False), (0.9, True)):
            most = share * now[key]
            limits = replace(free, **{name: most})
            own = replace(made, settings=replace(SETTINGS, limits=limits))
            told = [c for c in own.checks() if c.name == "design.limits"]
            where = [f"{row['cuff']}, {name}" for name in made.after]
            assert [c.where for c in told] == where * beyond
            for check in told:
                assert check.limit == pytest.approx(most)
                assert check.unit == unit
                assert check.sentence.endswith(f"lower limits.{name}")


@pytest.mark.slow
def test_what_drives_do_is_told_and_held_against_limits(made, felt):
    """The largest of torque, speed and power, over wearers and trials."""
    rows = {row["joint"]: row for row in made.drives()}
    own = trials(made, "after").values()
    for joint, row in rows.items():
        torques = np.concatenate([t.moment(joint) for t in own])
        rates = np.concatenate([t.velocity(joint) for t in own])
        assert row["after"] == pytest.approx(
            {
                "torque_nm": np.abs(torques).max(),
                "speed_deg_s": np.rad2deg(np.abs(rates).max()),
                "power_w": np.abs(torques * rates).max(),
            }
        )
    # A fifth more than today's at the knee.
    knee = rows["exo_knee"]
    ratio = knee["after"]["torque_nm"] / knee["before"]["torque_nm"]
    assert ratio == pytest.approx(1.2, abs=0.01)
    assert "exo_knee after" in made.table()
    assert made.summary()["drives"] == made.drives()
    for key, unit in (
        ("torque_nm", "N m"),
        ("speed_deg_s", "deg/s"),
        ("power_w", "W"),
    ):
        for share, beyond in ((0.99, False), (0.9, True)):
            most = share * knee["after"][key]
            limits = DesignLimits(
                migration_mm=None,
                moment_factor=None,
                drives={"exo_knee": DriveLimits(**{key: most})},
            )
            held = replace(made, settings=replace(SETTINGS, limits=limits))
            told = [c for c in held.checks() if c.name == "design.limits"]
            assert bool(told) == beyond
            for check in told:
                assert check.where.startswith("exo_knee, ")
                assert check.limit == pytest.approx(most)
                assert check.unit == unit
                assert check.sentence.endswith(
                    f"lower limits.drives.exo_knee.{key}"
                )


@pytest.mark.slow
def test_a_built_design_is_held_against_its_forecast(told, monkeypatch):
    """By the mean of what mats then show."""
    name, (moved, *_) = next(iter(told.after.items()))
    built = replace(told, measured={name: [moved.trial]})
    peak = built.peaks["pelvis"]
    most = np.abs(moved.trial.cuffs["pelvis"].normal).max()
    assert peak.measured_after == pytest.approx(most)
    checks = {c.where: c for c in built.checks() if c.name == "design.measured"}
    assert checks["pelvis"].value == pytest.approx(most)
    for middle, end in ((0.8 * most, 2.0 * most), (1.2 * most, 0.5 * most)):
        band = replace(
            peak, forecast_after=middle,
            forecast_low=0.5 * most, forecast_high=2.0 * most,
        )  # fmt: skip
        monkeypatch.setattr(Designed, "peaks", {"pelvis": band})
        own = replace(built).checks()  # nothing cached
        found = [c for c in own if c.name == "design.measured"]
        # The band's nearer end: what holds is not beyond it.
        assert [(c.holds, c.limit) for c in found] == [(True, end)]
    work = built.support["measured_after"]
    t = moved.trial
    power = sum(t.moment(j) * t.velocity(j) for j in t.coordinates.device)
    assert work == pytest.approx(np.trapezoid(power, t.times))


def test_the_table_and_the_summary_say_the_same(told):
    summary = json.loads(json.dumps(told.summary()))
    assert summary["norm_n"]["after"] == pytest.approx(told.found.norm_n)
    assert summary["norm_n"]["before"] == pytest.approx(told.today.norm_n)
    assert summary["trials"] == ["first_rise"]
    assert summary["extrapolated"] is True
    table = told.table()
    rows = [line.split() for line in table.splitlines()]
    peak = told.peaks["thigh"]
    own = next(r for r in rows if r[:1] == ["thigh"])
    for text, value in zip(
        own[-6:-1],
        (
            peak.measured_before,
            peak.model_before,
            peak.forecast_after,
            peak.forecast_low,
            peak.forecast_high,
        ),
        strict=True,
    ):
        assert float(text) == pytest.approx(value, abs=0.051)
    for row in told.felt():
        for when in ("before", "after"):
            own = next(r for r in rows if r[:2] == [row["cuff"], when])
            for text, value in zip(own[2:], row[when].values(), strict=True):
                assert float(text) == pytest.approx(value, abs=0.051)
    assert "pelvis.along_m *" in table
    assert "+40.0 mm" in table


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ({"name": "thigh.removed", "value": 1.0}, "left out"),
        ({"name": "thigh.removed", "value": 0.0}, "kept"),
        ({"name": "a.b", "unit": "m", "value": -0.0123}, "-12.3 mm"),
        ({"name": "a.b", "unit": "1", "value": 0.8}, "0.800"),
        ({"name": "a.b", "unit": "N m", "value": 2.0}, "2.000 N m"),
        ({"name": "a", "strap": 6e5, "strap_unit": "N/m"}, "stiff"),
        ({"name": "a", "strap": None, "strap_unit": "N/m"}, "stiff"),
        ({"name": "a", "strap": 4e5, "strap_unit": "N/m"}, "400 000 N/m"),
        ({"name": "a", "strap": 40.0, "strap_unit": "N m/rad"}, "40 N m/rad"),
    ],
)
def test_how_a_value_is_told(row, said):
    assert designed._told(row) == said


@pytest.mark.slow
def test_a_front_asks_for_shares_of_today_s_work(made, monkeypatch):
    """Factors may go as low, or as high, as the share asks for."""
    asked = []

    class Posed(DesignProblem):
        def __init__(self, wearers, settings, **given):
            asked.append((settings.assistance, given["support"]))
            super().__init__(wearers, settings, **given)

        def solve(self, **_):
            self.solve = lambda: DesignProblem.solve(self)
            return as_guessed(self)

    monkeypatch.setattr(designing, "DesignProblem", Posed)
    rows = pareto_front(made, (0.5, 1.0, 2.0))
    assert [r["share"] for r in rows] == [0.5, 1.0, 2.0]
    (low, mid, high) = asked
    assert low == ((pytest.approx(0.35), 1.3), 0.5)
    assert mid == ((0.7, 1.3), 1.0)
    assert high == ((0.7, pytest.approx(2.6)), 2.0)
    assert not any(r["dominated"] for r in rows)
    # All as today: its work, whatever was asked for.
    assert rows[0]["work_j"] == pytest.approx(made.support["before"])


@pytest.mark.slow
def test_points_of_a_front_that_nobody_would_take_are_told(
    made, monkeypatch, tmp_path, capsys
):
    """Less support for more force; a failed solve; all after Ctrl-C."""
    norms = {0.25: 9.0, 0.5: 5.0, 0.75: 4.0, 1.0: 6.0}
    between = []

    class Posed:
        def __init__(self, wearers, settings, support, **_):
            self.support = support

        def solve(self, **_):
            if self.support not in norms and between:
                raise KeyboardInterrupt
            solution = SimpleNamespace(
                success=self.support != 0.75,
                was_stopped=self.support not in norms,
            )
            return replace(
                made.found,
                solution=solution,
                values=made.found.values | {"share": self.support},
            )

    monkeypatch.setattr(designing, "DesignProblem", Posed)
    monkeypatch.setattr(designing, "design_of", lambda *_: Design())
    norm = property(lambda r: norms.get(r.values.get("share"), 1.0))
    monkeypatch.setattr(DesignResult, "norm_n", norm)
    rows = pareto_front(made)
    assert [r["share"] for r in rows] == list(norms)
    assert [r["success"] for r in rows] == [True, True, False, True]
    assert [r["dominated"] for r in rows][:2] == [True, False]
    between.append("solves")
    assert not command._write_front(made, tmp_path)
    printed = capsys.readouterr().out
    for words in ("0.25 (dominated)", "0.75 (failed)", "after 4 points"):
        assert words in printed
    assert (tmp_path / "front.png").is_file()
    monkeypatch.setattr(command, "pareto_front", lambda _: [])
    (tmp_path / "none").mkdir()
    assert not command._write_front(made, tmp_path / "none")
    assert capsys.readouterr().out == "stopped by the user after 0 points\n"
    assert not [*(tmp_path / "none").iterdir()]


def test_wearers_stand_for_others(made, monkeypatch):
    """Themselves, draws, and sizes on the design's grid."""
    (own, *_) = made.found.problem.wearers
    settings = replace(
        SETTINGS, draws=2, population=Population((1.7, 0.1), (70.0, 10.0))
    )
    monkeypatch.setattr(designing, "drawn", lambda w, count, seed: [w] * count)
    monkeypatch.setattr(
        designing, "sized", lambda w, people, phase: [people, phase.solver]
    )
    found = designing._wearers(own, settings)
    assert found == [own] * 3 + [settings.population, SETTINGS.solver]
    assert designing._wearers(own, SETTINGS) == [own]


def test_studies_of_one_name_are_numbered():
    named = [SimpleNamespace(name=n) for n in ("a", "b")]
    assert designing._names(named) == ["a", "b"]
    same = [SimpleNamespace(name="a")] * 2
    assert designing._names(same) == ["a 1", "a 2"]


def test_a_failed_solve_says_why():
    off = SimpleNamespace(success=False, status="no", explain=lambda: "far")
    found = SimpleNamespace(solution=off)
    (check,) = designed.Designed(SETTINGS, None, found, {}, {}).checks()
    assert (check.holds, check.sentence) == (False, "no: far")
    assert (
        designed._strap_unit(Variable("a.b", "rad/(N m)", 0, 1, 0, 1))
        == "N m/rad"
    )
