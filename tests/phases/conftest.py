import pytest

from drake_exo.phases.interaction_twin import interaction_twin


@pytest.fixture(scope="session")
def cuffs_twin():
    """Three exact trials with known cuffs, 50 nodes a second."""
    return interaction_twin()
