"""The table of faults stays true, and what tries them tells what tests notice from what not."""

from pathlib import Path

import faults
import pytest
from fault_table import FAULTS, Fault

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def texts():
    return faults.sources(ROOT)


@pytest.mark.parametrize("fault", [f for f in FAULTS if not f.version], ids=lambda f: f.name)
def test_a_fault_has_one_place_and_tests(fault, texts):
    assert fault.faulty != fault.original
    (path,) = faults.places(fault, texts)
    compile(texts[path].replace(fault.original, fault.faulty), path, "exec")
    assert any(list(ROOT.glob(word)) for word in fault.tests.split() if word.startswith("tests/"))


def test_the_faults_of_one_version_stand_together(texts):
    """One version of the decisions is there, with all its faults, and nothing of another."""
    counts = {}
    for fault in FAULTS:
        if fault.version:
            counts.setdefault(fault.version, set()).add(len(faults.places(fault, texts)))
    assert sorted(map(sorted, counts.values())) == [[0]] * (len(counts) - 1) + [[1]]


def test_every_area_has_its_faults():
    assert len({fault.name for fault in FAULTS}) == len(FAULTS) >= 40
    areas = [fault.area for fault in FAULTS]
    assert set(areas) == {"models", "composition", "optimisation", "diagnosis"}
    assert min(map(areas.count, set(areas))) >= 10


@pytest.mark.slow
def test_what_tests_notice_is_killed(tmp_path):
    root, copy = tmp_path / "checkout", tmp_path / "folder"
    for name in ("skhyst", "tests", "benchmarks", "tools", "docs"):
        (root / name).mkdir(parents=True)
    copy.mkdir()
    (root / "pyproject.toml").write_text("[tool.pytest.ini_options]\nmarkers = ['slow']\n")
    (root / "skhyst" / "__init__.py").write_text("def sign(x):\n    return (x > 0) - (x < 0)\n")
    test = "import pytest\nfrom skhyst import sign\n\ndef test_sign():\n    assert sign(2) == 1\n"
    slow = "\n@pytest.mark.slow\ndef test_zero():\n    assert sign(0) == 0\n"
    (root / "tests" / "test_sign.py").write_text(test + slow)
    laboratory = faults.Laboratory(root, copy)

    def outcome(original, faulty, tests="tests/**/test_sign.py", tier="all"):
        return laboratory.judge(Fault("", "models", original, faulty, tests), tier)[0]

    assert outcome("(x > 0) -", "(x < 0) -") == "killed"
    assert outcome("x > 0", "x >= 0") == "killed, slow"
    assert outcome("x > 0", "x >= 0", tier="default") == "survived"
    assert outcome("- (x < 0)", "- 0") == "survived"
    assert outcome("absent", "present") == "not found"
    assert outcome("x", "y") == "found 3 times"
    assert outcome("sign", "sing", "tests/test_absent.py") == "no tests"
    assert laboratory.texts == faults.sources(laboratory.root)
