"""The built FMUs: `make fmus` makes them, these tests only load them."""

from pathlib import Path

import pytest

from tests.fmus.instance import FMUS

NAMES = (
    "ScalarPlant",
    "ScalarController",
    "MatchedPlant",
    "MatchedController",
    "StrictFeedbackPlant",
    "StateFeedbackController",
    "ObserverFormPlant",
    "OutputFeedbackController",
    "Reference",
    "Disturbance",
    "Noise",
    "Saturation",
    "Lag",
    "Delay",
)


@pytest.fixture(params=NAMES)
def fmu(request: pytest.FixtureRequest) -> Path:
    """Each built FMU in turn."""
    return FMUS / f"{request.param}.fmu"
