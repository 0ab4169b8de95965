"""Clock of the plates, by what the feet must bear."""

import numpy as np
import pytest

from drake_exo.measurement.clocks import force_delay

TIME = np.arange(300) / 100.0


def pulse(t):
    return 700.0 + 300.0 * np.exp(-(((t - 1.4) / 0.2) ** 2))


@pytest.mark.parametrize("late", [-0.021, 0.0, 0.017])
def test_plates_are_timed_by_what_the_feet_must_bear(late):
    """To a millisecond, an offset of the force notwithstanding."""
    used = (TIME > 0.5) & (TIME < 2.5)
    force = pulse(TIME - late) + 15.0
    found = force_delay(TIME, pulse(TIME), force, used)
    assert found == pytest.approx(late, abs=1e-3)


def test_a_search_ends_at_its_reach():
    used = np.ones(300, bool)
    force = pulse(TIME - 0.1)
    assert force_delay(TIME, pulse(TIME), force, used, 0.03) == 0.03
