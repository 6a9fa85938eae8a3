"""Models that an earlier version has saved are read, and answer as they did, bit for bit."""

import io
import json
import tarfile

import numpy as np
import pytest
from save_models import DT, FOLDER, answer, machine, recording

from skhyst.persistence import from_json, load_model

pytest.importorskip("skops.io")


# whose outputs were differences of large numbers under a large drive, or of exp(z) and one, or sums
# in another order
ROUNDED = {
    "BoucWen": 1e-14,
    "Dahl": 1e-6,  # the force is not determined by these data, and 1e9 times the response
    "EndStops": 1e-14,
    "SlewLimit": 1e-9,
    "TankChain": 1e-9,
}
# until a start from zero began at the first sample, a ramp from zero led to it
ON_A_RAMP = {"BoucWenStage", "EndStops", "FrictionStage", "RestoringForce"}


def on_a_ramp(model, X):
    """Return the free run of a stage whose drive was zero one interval before each record."""
    before = 0.0, 0.0, 0.0, 0.0, 1.0
    drives = X["drive"].groupby(level="record", sort=False)
    return np.concatenate([model.operator_.run(u, DT, before)[0] for _, u in drives])


def archives():
    """Yield the name of an archive and of a model in it, and its files."""
    for path in sorted(FOLDER.glob("*.tar.xz")):
        with tarfile.open(path) as archive:
            files = {info.name: archive.extractfile(info).read() for info in archive}
        for name in files:
            if name.endswith(".npy"):
                own = {key: files.get(f"{name[:-4]}.{key}") for key in ("skops", "json", "npy")}
                yield pytest.param(own, files["machine.json"], id=f"{path.stem}, {name[:-4]}")


@pytest.fixture(scope="module")
def data():
    return recording()


@pytest.mark.parametrize(("files", "written_on"), list(archives()))
@pytest.mark.filterwarnings("ignore:.* was written by skhyst", "ignore:.*by an earlier version")
def test_what_was_saved_is_read(files, written_on, data, tmp_path):
    X, y = data
    expected = np.load(io.BytesIO(files["npy"]))
    path = tmp_path / "model.skops"
    path.write_bytes(files["skops"])
    found = [load_model(path)]
    found += [] if files["json"] is None else [from_json(files["json"].decode())]
    for model in found:
        X_own = X[list(model.feature_names_in_)]
        ramp = type(model).__name__ in ON_A_RAMP
        own = on_a_ramp(model, X_own) if ramp else answer(model, X_own, y)
        kind = type(model).__name__
        if json.loads(written_on) == machine() and kind not in ROUNDED:
            np.testing.assert_array_equal(own, expected)
        else:
            tolerance = ROUNDED.get(kind, 1e-9)
            np.testing.assert_allclose(own, expected, tolerance, tolerance * np.ptp(expected))
