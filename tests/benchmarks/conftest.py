"""What the tests of both studies share."""

import pytest
from blind_study import Case


@pytest.fixture
def row():
    """Return a function that makes the row of a plant in the results of a study."""

    def make(effect, claimed="", ambiguous="", kind="single", **more):
        case = Case(kind, effect, "bouc_wen", 0.002, 0, 6000)
        return {
            **case._asdict(),
            "named": claimed.split("+")[0] or "none",
            "claimed": claimed,
            "ambiguous": ambiguous,
            "verdict": "noise",
            "before": 5.0,
            "after": 1.0,
            "refitted": 1.0,
            "effect_over_noise": 4.0,
            "seconds": 1.0,
            "processor_seconds": 2.0,
            **more,
        }

    return make
