"""The dataset of the models' tests, to train on."""

from tests.models.conftest import dataset

__all__ = ["dataset"]
