"""`skhyst app`: serve the page of `skhyst.app`, to this machine only."""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

_PAGE = Path(__file__).parents[1] / "app" / "_server.py"
_OPTIONS = {
    "server.address": "127.0.0.1",
    "server.fileWatcherType": "none",
    "server.maxUploadSize": "2000",  # MB
    "server.showEmailPrompt": "false",
    "browser.gatherUsageStats": "false",
    "client.toolbarMode": "minimal",
}


def app(options):
    """Serve the page until Ctrl-C."""
    if find_spec("streamlit") is None:
        raise ImportError(
            "skhyst app needs Streamlit, which is not installed. Install it with: "
            'python -m pip install "skhyst[app]"'
        )
    own = {"server.port": options.port, "server.headless": str(options.no_browser).lower()}
    flags = [f"--{name}={value}" for name, value in {**_OPTIONS, **own}.items()]
    command = [sys.executable, "-m", "streamlit", "run", str(_PAGE), *flags]
    with TemporaryDirectory(prefix="skhyst") as folder:  # for uploaded files
        done = subprocess.run(command, env=os.environ | {"TMPDIR": folder})
    if done.returncode:
        raise OSError(f"The page could not be served at port {options.port}: try another --port.")
