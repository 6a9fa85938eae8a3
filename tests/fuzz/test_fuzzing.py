"""What was found stays mended, and an attack sees what is broken."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

fuzzing = pytest.importorskip("fuzzing")  # it sets limits of POSIX
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits and /proc of Linux")

FAULTY = f"""
import json, os, signal, subprocess, sys
sys.path.insert(0, {str(Path(fuzzing.__file__).parent)!r})
import fuzzing, sound

def loop(path):
    while True:
        pass

faults = (
    lambda path: int("a"),  # as it should be
    lambda path: {{}}["key"],
    loop,
    lambda path: bytearray(b"a") * (2 * fuzzing.BYTES),
    lambda path: (bytes(2 * fuzzing.BYTES), loop(path)),  # what the second try must end
    lambda path: os.kill(os.getpid(), signal.SIGSEGV),
    lambda path: eval("1 + 1"),
    lambda path: subprocess.run(["true"]),
    lambda path: path.with_name("other").write_text(""),
    lambda path: open("/etc/passwd").close(),
)
first, seen = json.loads(sys.argv[2])[3], []

def faulty(path):
    data = path.read_bytes()
    if data not in sound.seeds("model"):
        if data not in seen:  # what asks for memory is tried again
            seen.append(data)
        faults[first + seen.index(data)](path)

fuzzing.SECONDS, fuzzing.BYTES = 2, 10**8  # touched within a fraction of the time
fuzzing.FORMATS["model"] = faulty
fuzzing.main(sys.argv[1:])
"""
SEEN = (
    *("KeyError: 'key'", "hang", "memory", "hang", "ends with -11", "runs <string>"),
    *("subprocess.Popen", "writes ", "reads /etc/passwd"),
)


@pytest.mark.slow
def test_each_fault_is_seen(tmp_path):
    program = tmp_path / "faulty.py"
    program.write_text(FAULTY)
    count, broken = fuzzing.run("model", count=10, keep=tmp_path / "kept", program=program)
    assert count == 10
    assert [number for number, _ in broken] == list(range(1, 10))
    for (_, told), seen in zip(broken, SEEN, strict=True):
        assert seen in told
    assert {file.name for file in (tmp_path / "kept" / "broken" / "model").iterdir()} == set(
        "123456789"
    )


@pytest.mark.slow
def test_what_was_found_stays_mended(tmp_path):
    (tmp_path / "broken").mkdir()
    command = [sys.executable, fuzzing.__file__, "--replay", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert lines[-1] == ["end"], (lines[-1:], done.stderr)
    assert [line for line in lines if line[0] == "broken"] == []
    assert len(lines) > 5 * len(fuzzing.FORMATS)
