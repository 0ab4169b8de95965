import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files.tables import MarkerData
from drake_exo.measurement.recording import fill_gaps

TIME = np.arange(200) / 100.0
PATH = np.column_stack([np.sin(TIME), TIME**2, np.cos(2.0 * TIME)])


@pytest.fixture
def data():
    p = np.stack([PATH, 2.0 * PATH], axis=1)
    p[50:60, 1] = np.nan
    p[62:65, 1] = np.nan
    return MarkerData(TIME, ("a", "b"), p, 100.0, "f.c3d")


def test_gaps_are_filled_smoothly(data):
    found, shares = fill_gaps(data, ["a", "b", "b"], 0.1)
    assert shares == {"b": 13 / 200}
    np.testing.assert_allclose(found.positions[:, 1], 2.0 * PATH, atol=2e-5)
    np.testing.assert_array_equal(found.positions[:, 0], PATH)
    assert np.isnan(data.positions[55, 1]).all()  # the input stays


def test_markers_that_are_not_needed_keep_their_gaps(data):
    found, shares = fill_gaps(data, ["a"], 0.0)
    assert shares == {} and np.isnan(found.positions[55, 1]).all()


def test_longer_gaps_are_refused(data):
    with pytest.raises(InputError, match=r"'b'.*10 frames from 0\.5 s"):
        fill_gaps(data, ["b"], 0.09)
    with pytest.raises(InputError, match="fill_gaps_s"):
        fill_gaps(data, ["b"], 0.0)


def test_gaps_at_the_ends_are_refused(data):
    data.positions[:2, 0] = np.nan
    with pytest.raises(InputError, match="cut those frames off"):
        fill_gaps(data, ["a"], 1.0)


def test_unknown_markers_are_refused(data):
    with pytest.raises(InputError, match="no marker 'c'"):
        fill_gaps(data, ["c"], 1.0)
