"""Install wheel and sdist into bare environments, and use them: `python tools/distributions.py`.

Both are built (`pip install build pipx`). From a folder without the sources each fits a model,
saves and loads it, and lists the effects; the wheel also serves the page, started by ``pipx run``.
"""

import socket
import subprocess
import sys
import time
import venv
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.error import URLError
from urllib.request import urlopen

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 600.0  # s, in which pipx installs what the page needs
USE = """
import sys
import numpy as np
import skhyst
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.persistence import from_json, to_json
assert skhyst.__file__.startswith(sys.prefix), skhyst.__file__
u = np.sin(np.arange(400) / 20.0)[:, None]
model = PrandtlIshlinskii(5, dt=0.01).fit(u, u[:, 0] + 0.1 * np.tanh(3.0 * u[:, 0]))
again = from_json(to_json(model))
assert np.array_equal(again.predict(u), model.predict(u))
"""


def run(*command, cwd):
    """Run a command and return what it prints; its errors are shown."""
    told = [str(part) for part in command]
    return subprocess.run(told, cwd=cwd, check=True, stdout=subprocess.PIPE, text=True).stdout


def use(distribution, folder):
    """Install a distribution into an environment of its own without extras, and use it."""
    environment = folder / distribution.name.replace(".", "_")
    venv.create(environment, with_pip=True)
    programs = environment / ("Scripts" if sys.platform == "win32" else "bin")
    run(programs / "python", "-m", "pip", "install", "--quiet", distribution, cwd=folder)
    run(programs / "python", "-c", USE, cwd=folder)
    listed = run(programs / "skhyst", "effects", cwd=folder)
    assert "creep" in listed, listed
    missing = subprocess.run(
        [programs / "skhyst", "app"], cwd=folder, check=False, capture_output=True, text=True
    )
    assert 'pip install "skhyst[app]"' in missing.stderr, missing.stderr


def serve(wheel, folder):
    """Start the page of a wheel by pipx, and fetch it; return the seconds until it answers."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    pipx = [sys.executable, "-m", "pipx", "run", "--spec", f"{wheel}[app]", "skhyst", "app"]
    start = time.monotonic()
    with subprocess.Popen([*pipx, "--no-browser", "--port", str(port)], cwd=folder) as page:
        try:
            while page.poll() is None and time.monotonic() - start < PATIENCE:
                try:
                    with urlopen(f"http://127.0.0.1:{port}/", timeout=10.0) as answer:
                        assert "frame-ancestors" in answer.headers["content-security-policy"]
                        return time.monotonic() - start
                except URLError:
                    time.sleep(0.5)
        finally:
            page.terminate()
    raise RuntimeError("The page did not answer.")


def main():
    with TemporaryDirectory() as name:
        folder = Path(name)
        run(sys.executable, "-m", "build", "--outdir", folder, ROOT, cwd=folder)
        wheel, sdist = (next(folder.glob(suffix)) for suffix in ("*.whl", "*.tar.gz"))
        for distribution in (wheel, sdist):
            use(distribution, folder)
            print(f"{distribution.name}: {distribution.stat().st_size / 1e6:.2f} MB, works")
        print(f"skhyst app by pipx: answers after {serve(wheel, folder):.0f} s")


if __name__ == "__main__":
    main()
