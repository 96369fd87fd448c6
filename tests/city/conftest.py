"""What several test files share: compiled code, and one place under every condition."""

import pytest

import artifact_city
from city.helpers import PLACE, under


@pytest.fixture(scope="session", autouse=True)
def compiled():
    """On a fresh machine the first use compiles: not within a test that measures time."""
    artifact_city.compile_all()


@pytest.fixture(scope="session")
def seen():
    """One place under every condition, from the same pose."""
    return {name: artifact_city.render_frame(under(name), PLACE) for name in artifact_city.CONDITIONS}
