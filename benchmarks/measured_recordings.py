"""Search measured recordings for missing effects: `python benchmarks/measured_recordings.py`.

The recordings are not part of the project; the folder is looked for beside the checkout or named
with --data. Each is searched twice, from Python and by the command line, and both must agree.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.records import read_records

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args()
    path = options.data / "piezo_afm" / "SG_data_triangle_sin_raw.mat"
    if not path.exists():
        sys.exit(f"{path} is absent.")
    X, y = read_records(path, drive="V", response="SG[0]", sampling_rate=1.0)
    n = int(0.6 * len(y))
    search = EffectSearchCV(PrandtlIshlinskii(), random_state=0, n_jobs=2).fit(X[:n], y[:n])
    span = np.ptp(y.to_numpy()) / 100.0
    claims = "; ".join(
        f"{row.effect} (or {', '.join(row.ambiguous_with) or '-'})"
        for row in search.history_.itertuples()
    )
    before = search.held_out_error(X[n:], y[n:], declared=True) / span
    after = search.held_out_error(X[n:], y[n:]) / span
    print(
        f"piezo_afm x, last 40 % held out: {before:.3f} % -> {after:.3f} % of the range; {claims}; "
        f"left: {search.verdict_}"
    )
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder, "result.json")
        command = [sys.executable, "-m", "skhyst", "diagnose", str(path), "--drive", "V"]
        command += ["--response", "SG[0]", "--sampling-rate", "1", "--train-fraction", "0.6"]
        command += ["--model", "prandtl_ishlinskii", "--seed", "0", "--jobs", "2", "--quiet"]
        subprocess.run([*command, "--json", str(output)], check=True)
        held_out = json.loads(output.read_text())["held_out"]
    print(f"the same by the command line: {held_out}")


if __name__ == "__main__":
    main()
