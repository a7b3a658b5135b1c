"""What training is tested on."""

import pytest

from clothkit.dataset.store import Dataset
from tests.crumpled import crumpled


@pytest.fixture(scope="session")
def dataset() -> Dataset:
    return crumpled(6, 0)
