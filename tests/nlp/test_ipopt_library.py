"""IPOPT through its C interface."""

import threading

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.nlp.ipopt_library import run_ipopt

OPTIONS = {"print_level": 0, "sb": "yes", "tol": 1e-9}


def hanging(x0=(4.0, 4.0), options=None, told=None, at=None, **functions):
    """The point nearest to (3, 1) with x y = 1 and x at most 2."""
    entries = {
        "cost": lambda x: (x[0] - 3.0) ** 2 + (x[1] - 1.0) ** 2,
        "gradient": lambda x: 2.0 * (x - [3.0, 1.0]),
        "constraints": lambda x: x[:1] * x[1:],
        "jacobian": lambda x: x[::-1],
        "hessian": lambda x, lam, factor: (
            2.0 * factor * np.array([1.0, 0.0, 1.0]) + [0.0, lam[0], 0.0]
        ),
        "watch": lambda *row: True if told is None else told.append(row) or 1,
    }
    return run_ipopt(
        np.array(x0),
        (np.array([-np.inf, -np.inf]), np.array([2.0, np.inf])),
        (np.ones(1), np.ones(1)),
        (np.zeros(2, int), np.arange(2)),
        (np.array([0, 1, 1]), np.array([0, 0, 1])),
        *(functions.get(name, entry) for name, entry in entries.items()),
        options={**OPTIONS, **(options or {})},
        **(at or {}),
    )


def test_point_cost_and_multipliers_of_a_bound_optimum():
    told = []
    found = hanging(told=told)
    assert found.status == 0
    np.testing.assert_allclose(found.x, [2.0, 0.5], atol=1e-7)
    assert found.cost == pytest.approx(1.25)
    # ∇f + λ ∇(x y) - z_low + z_high = 0
    np.testing.assert_allclose(found.multipliers, [0.5], atol=1e-6)
    np.testing.assert_allclose(found.at_bounds[0], [0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(found.at_bounds[1], [1.75, 0.0], atol=1e-6)
    modes, iterations, costs, primal, *_ = zip(*told, strict=True)
    assert set(modes) == {0} and iterations == tuple(range(len(told)))
    # The start is pushed within the bound x ≤ 2 before the first iteration.
    assert costs[0] == pytest.approx(10.0, abs=0.1) and primal[-1] < 1e-8
    assert all(len(row) == 11 for row in told)


def test_a_warm_start_takes_its_multipliers():
    cold, told = hanging(), []
    warm = {
        "warm_start_init_point": "yes",
        "mu_init": 1e-9,
        **dict.fromkeys(
            (
                "warm_start_bound_push",
                "warm_start_bound_frac",
                "warm_start_mult_bound_push",
            ),
            1e-9,
        ),
    }
    at = {"multipliers": cold.multipliers, "at_bounds": cold.at_bounds}
    again = hanging(cold.x, warm, told, at)
    np.testing.assert_allclose(again.x, cold.x, atol=1e-8)
    assert len(told) <= 3
    # What was handed over is not written to.
    assert again.multipliers is not cold.multipliers
    assert again.at_bounds[1] is not cold.at_bounds[1]


@pytest.mark.parametrize(
    "name",
    ["cost", "gradient", "constraints", "jacobian", "hessian", "watch"],
)
def test_an_error_of_a_function_ends_the_run_and_is_raised(name):
    class OwnError(Exception):
        pass

    calls = []

    def fails(*_):
        calls.append(name)
        raise OwnError(name)

    with pytest.raises(OwnError, match=name):
        hanging(**{name: fails})
    assert calls == [name]  # nothing is asked again


def test_a_value_that_is_not_finite_shortens_the_step():
    """IPOPT asks elsewhere, as for a logarithm beyond its domain."""
    asked = []

    def cost(x):
        asked.append(x[1])
        return np.nan if x[1] < 0.3 else (x[0] - 3) ** 2 + (x[1] - 1) ** 2

    found = hanging(cost=cost, x0=(0.4, 9.0))
    assert found.status == 0
    np.testing.assert_allclose(found.x, [2.0, 0.5], atol=1e-7)
    nowhere = hanging(cost=lambda x: np.nan)
    assert nowhere.status == -13


def test_watch_ends_the_run():
    assert hanging(watch=lambda mode, iteration, *_: iteration < 2).status == 5


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("no_such", 1),
        ("tol", 1),
        ("mu_strategy", "worst"),
        ("max_iter", 2**32 + 5),
        ("tol", None),
    ],
)
def test_an_option_that_ipopt_refuses_is_named(name, value):
    with pytest.raises(InputError, match=f"no option '{name}' of {value!r}"):
        hanging(options={name: value})


def test_options_are_numbers_of_numpy_too():
    options = {"max_iter": np.int64(2), "tol": np.float64(1e-9)}
    assert hanging(options=options).status == -1


def test_options_in_the_working_folder_are_not_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ipopt.opt").write_text("max_iter 1\n")
    assert hanging().status == 0
    assert hanging(options={"option_file_name": "ipopt.opt"}).status == -1


@pytest.mark.parametrize("n", [0, 1])
@pytest.mark.parametrize(("least", "status"), [(0.3, 0), (0.4, 2)])
def test_a_constraint_that_nothing_moves(n, least, status):
    """Without entries in the Jacobian, and without unknowns."""
    found = run_ipopt(
        np.full(n, 2.0),
        (np.full(n, -9.0), np.full(n, 9.0)),
        (np.array([least]), np.array([np.inf])),
        (np.empty(0, int), np.empty(0, int)),
        (np.arange(n), np.arange(n)),
        lambda x: x @ x,
        lambda x: 2.0 * x,
        lambda x: np.array([0.3]),
        lambda x: np.empty(0),
        lambda x, lam, factor: np.full(n, 2.0 * factor),
        lambda *_: True,
        options=OPTIONS,
    )
    assert found.status == status
    assert len(found.x) == n and len(found.multipliers) == 1
    if status == 0:
        np.testing.assert_allclose(found.x, 0.0, atol=1e-8)


def test_no_constraints():
    found = run_ipopt(
        np.array([3.0]),
        (np.full(1, -np.inf), np.full(1, np.inf)),
        (np.empty(0), np.empty(0)),
        (np.empty(0, int), np.empty(0, int)),
        (np.zeros(1, int), np.zeros(1, int)),
        lambda x: (x[0] - 1.0) ** 2,
        lambda x: 2.0 * (x - 1.0),
        lambda x: np.empty(0),
        lambda x: np.empty(0),
        lambda x, lam, factor: np.array([2.0 * factor]),
        lambda *_: True,
        options=OPTIONS,
    )
    assert found.x == pytest.approx([1.0]) and len(found.multipliers) == 0


def test_other_threads_go_on_while_ipopt_computes():
    """The interpreter's lock is free between the functions."""
    ticks, done = [], threading.Event()

    def tick():
        while not done.wait(1e-4):
            ticks.append(1)

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        hanging(cost=lambda x: done.wait(0.01) or (x @ x))
    finally:
        done.set()
        thread.join()
    assert ticks
