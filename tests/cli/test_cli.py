"""The command line: the same results as Python, clear errors, nothing lost."""

import ast
import importlib.util
import json
import os
import pickle
import re
import subprocess
import sys
import warnings
from functools import partial
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
import pytest

import skhyst
from skhyst.cli import main
from skhyst.cli._demo_recording import SECRETS, make_demo_recording
from skhyst.cli._diagnose import _training_rows
from skhyst.cli._main import _parser
from skhyst.cli._messages import as_options
from skhyst.cli._reading_options import _READING
from skhyst.compose import Cascade
from skhyst.diagnosis import EffectSearchCV, next_experiment
from skhyst.discovery import parse_model
from skhyst.exceptions import RecordError, TimeUnitWarning
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.inspection import compare_models
from skhyst.linear import Gain, SecondOrderMode
from skhyst.records import read_records, record_slices


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A recording with a clipped sensor, in a CSV file."""
    rng = np.random.default_rng(7)
    time = np.arange(1000) * 3e-3
    swell = 0.4 + 0.6 * np.sin(2 * np.pi * 0.3 * time) ** 2
    drive = 40.0 * np.sin(2 * np.pi * 2.0 * time) * swell
    position = np.minimum(0.02 * drive, 0.4) + 0.002 * rng.normal(size=time.size)
    path = tmp_path_factory.mktemp("recordings") / "stage.csv"
    pd.DataFrame({"t": time, "volt": drive, "um": position}).to_csv(path, index=False)
    return path


EFFECTS = ["output_saturation", "offset", "lag"]


def searched(X, y):
    return EffectSearchCV(Gain(), effects=EFFECTS, random_state=0).fit(X, y)


@pytest.fixture(scope="module")
def in_python(recording):
    """The recording as it is read, and the search of it."""
    X, y = read_records(recording, drive="volt", response="um", time="t")
    return X, y, searched(X, y)


def arguments(path, *more):
    columns = ["--drive", "volt", "--response", "um", "--time", "t"]
    effects = ["--effects", ",".join(EFFECTS), "--jobs", "1", "--quiet"]
    return ["diagnose", str(path), *columns, *effects, "--model", "gain", *more]


def files(folder, report):
    """Options that write all files to a folder."""
    names = {"--json": "out.json", "--report": report, "--save": "model.joblib"}
    return [part for option, name in names.items() for part in (option, str(folder / name))]


@pytest.mark.slow
def test_next_writes_the_drive_that_python_proposes(recording, in_python, tmp_path, capsys):
    path = tmp_path / "new" / "drive.csv"
    more = ["-o", str(path), "--limits", "-40", "40", "--rate", "2000", "--duration", "0.3"]
    command = ["next", *arguments(recording, *more)[1:]]
    assert main(command) == 0
    table = pd.read_csv(path)
    experiment = next_experiment(in_python[-1], (-40.0, 40.0), 2000.0, 0.3)
    drive = experiment.from_rest()
    np.testing.assert_allclose(table["drive"], drive)
    np.testing.assert_allclose(table["time"], drive.index)
    assert f"record next: {experiment.reason}" in capsys.readouterr().out
    assert main(command) == 1
    assert "drive.csv exists already: add --force" in capsys.readouterr().err
    assert main([*command, "--force"]) == 0
    path.unlink()
    command[command.index("--limits") + 1] = "50"
    assert main(command) == 1
    assert "LOW HIGH" in capsys.readouterr().err
    assert not path.exists()


@pytest.mark.slow
def test_diagnose_equals_python(recording, in_python, tmp_path, capsys):
    folder = tmp_path / "new" / "folder"
    assert main(arguments(recording, *files(folder, "out.html"))) == 0
    X, _, search = in_python
    result = json.loads((folder / "out.json").read_text())
    assert result["effects"] == search.effects_ == ["output_saturation"]
    assert result["error_after"] == search.error_after_
    assert result["error_before"] == search.error_before_
    model = joblib.load(folder / "model.joblib")
    np.testing.assert_array_equal(model.predict(X), search.predict(X))
    assert "<html" in (folder / "out.html").read_text().lower()
    printed = capsys.readouterr()
    assert "missing: output_saturation" in printed.out
    assert printed.err == ""


@pytest.mark.slow
def test_columns_are_found_and_told(recording, capsys):
    command = ["diagnose", str(recording), *arguments(recording)[8:]]
    assert main(command) == 0
    printed = capsys.readouterr().out
    for role, name in (("drive", "volt"), ("response", "um"), ("time", "t")):
        assert f"{role}: '{name}' (by its name); --{role} chooses another" in printed
    assert main(arguments(recording)) == 0
    assert printed.endswith(capsys.readouterr().out)


def test_channels_in_files_of_their_own_are_joined(recording, tmp_path, capsys):
    table = pd.read_csv(recording)
    files = [tmp_path / f"{name}.csv" for name in ("volt", "um")]
    for path in files:
        table[["t", path.stem]].to_csv(path, index=False)
    assert main(["inspect", *map(str, files), "--join"]) == 0
    printed = capsys.readouterr().out
    assert "1000 samples every 0.003 s" in printed
    assert all(f"'{name}'" in printed for name in ("t", "volt", "um"))
    assert main(["diagnose", *map(str, files)]) == 1
    assert "add --join" in capsys.readouterr().err


FEW = {"gain": Gain(), "second_order_mode": SecondOrderMode()}


def test_without_a_model_a_few_are_compared_and_one_is_taken(
    recording, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("skhyst.cli._diagnose.compare_models", partial(compare_models, models=FEW))
    command = [part for part in arguments(recording) if part not in ("--model", "gain")]
    assert main([*command, "--json", str(tmp_path / "out.json")]) == 0
    told = capsys.readouterr().out
    found = json.loads((tmp_path / "out.json").read_text())
    assert found["comparison"]["taken"] == "gain"
    assert found["declared_model"].startswith("Gain")
    assert found["command"].endswith("--model gain")  # which does the same again
    assert all(f"{name} " in told for name in FEW)
    assert f"\n{found['comparison']['reason']}" in told
    # what is wrong with a model is told before anything is read
    assert main([*command, "--model", "gian"]) == 1


@pytest.mark.slow
def test_a_terminal_is_asked_for_the_model(recording, capsys, monkeypatch):
    monkeypatch.setattr("skhyst.cli._diagnose.compare_models", partial(compare_models, models=FEW))
    for stream in ("stdin", "stdout"):
        monkeypatch.setattr(f"sys.{stream}.isatty", lambda: True, raising=False)
    answers = iter(["no_such_model", "backlash+gain"])
    monkeypatch.setattr("builtins.input", lambda asked: next(answers))
    command = ["diagnose", str(recording), "--effects", "offset", "--jobs", "1"]
    assert main(command) == 0
    told = capsys.readouterr().out
    assert "What moves? The drive is 'volt', the response is 'um'." in told
    assert "There is no model 'no_such_model'" in told


def test_one_model_is_taken_for_a_table(recording, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("skhyst.cli._diagnose.compare_models", partial(compare_models, models=FEW))
    files = [tmp_path / "none.csv", recording]
    command = ["diagnose", *map(str, files), "--effects", "offset", "--jobs", "1", "--quiet"]
    assert main([*command, "--summary", str(tmp_path / "table.csv")]) == 0
    assert f"{recording}:" in capsys.readouterr().out


def test_inspect_tells_and_draws(recording, tmp_path, capsys):
    picture = tmp_path / "rig.png"
    assert main(["inspect", str(recording), "--picture", str(picture)]) == 0
    printed = capsys.readouterr().out
    assert "drive     'volt'" in printed
    assert "1000 samples every 0.003 s" in printed
    assert "\nloops:\n  record 0" in printed
    assert picture.read_bytes().startswith(b"\x89PNG")
    table = pd.read_csv(recording).rename(columns={"volt": "a", "um": "b"})
    table.to_csv(tmp_path / "unknown.csv", index=False)
    assert main(["inspect", str(tmp_path / "unknown.csv"), str(recording)]) == 0
    assert "more than one column may be the drive" in capsys.readouterr().out
    assert main(["diagnose", str(tmp_path / "unknown.csv")]) == 1
    assert "pass --drive NAME. Candidates: 'a', 'b'" in capsys.readouterr().err
    table.assign(b=[-9999.0, *table["b"][1:]]).to_csv(tmp_path / "coded.csv", index=False)
    columns = ["--drive", "a", "--response", "b"]
    assert main(["inspect", str(tmp_path / "coded.csv"), *columns]) == 0
    assert "Pass --on-missing interpolate or --on-missing drop" in capsys.readouterr().out


@pytest.mark.slow
def test_progress_goes_to_standard_error_and_no_pickle_is_loaded(recording, capsys, monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("something was unpickled")

    assert main(arguments(recording)) == 0  # compiled code comes from a cache, which is pickled
    for module, name in ((pickle, "load"), (pickle, "loads"), (joblib, "load")):
        monkeypatch.setattr(module, name, refuse)
    assert main([a for a in arguments(recording) if a != "--quiet"]) == 0
    printed = capsys.readouterr()
    assert "declared model" in printed.err
    assert "declared model:" not in printed.out


@pytest.mark.slow
def test_train_fraction_is_kept_away(recording, tmp_path):
    path = tmp_path / "out.json"
    assert main(arguments(recording, "--train-fraction", "0.6", "--json", str(path))) == 0
    X, y = read_records(recording, drive="volt", response="um", time="t")
    n = int(0.6 * len(y))
    search = searched(X[:n], y[:n])
    held_out = json.loads(path.read_text())["held_out"]
    assert search.held_out_error(X[n:], y[n:]) in held_out.values()
    assert search.held_out_error(X[n:], y[n:], declared=True) in held_out.values()


def test_a_fraction_is_that_of_one_record_whatever_rows_it_has_lost():
    X = pd.DataFrame({"volt": np.arange(200.0)}, 0.1 * np.arange(200)).drop(0.1 * 31)
    assert _training_rows(X, 0.5) == 99


@pytest.mark.slow
def test_uneven_readings_are_refused_or_interpolated(recording, tmp_path, capsys, monkeypatch):
    # interpolated readings leave more than noise, so that models are compared
    monkeypatch.setattr("skhyst.cli._diagnose.compare_models", partial(compare_models, models=FEW))
    table = pd.read_csv(recording)
    rows = np.sort(np.random.default_rng(0).choice(len(table), len(table) // 2, replace=False))
    path, found = tmp_path / "uneven.csv", tmp_path / "out.json"
    table.iloc[rows].to_csv(path, index=False)
    assert main(arguments(path)) == 1
    told = capsys.readouterr().err
    assert "interpolate with --resample auto" in told
    assert "skhyst." not in told
    more = "--resample", "auto", "--train-fraction", "0.6", "--json", str(found)
    assert main(arguments(path, *more)) == 0
    result = json.loads(found.read_text())
    assert result["effects"] == ["output_saturation"]
    error = result["data"]["resampling_error"]
    assert f"changes the response by about {error:#.3g} " in capsys.readouterr().out
    assert result["held_out"]["n_samples"] == len(rows) - int(0.6 * len(rows))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--drive", "nothing"], "volt"),
        (["--model", "prandl_ishlinski"], "did you mean prandtl_ishlinskii,"),
        (["--model", "prandtl_ishlinskii(n_operators=__import__('os'))"], "do not fit"),
        (["--model", "1 +"], "not understood"),
        (["--effects", "asymetry"], "such as asymmetry,"),
        (["--unit", "um"], "COLUMN=UNIT"),
        (["--drive", "um"], "column 0 of X twice"),
        (["--rows", "1-2"], "A:B"),
        (["--train-fraction", "1.5"], "between 0 and 1"),
        (["--report", "report.pdf"], ".html"),
    ],
)
def test_errors_are_clear(recording, capsys, more, message):
    assert main(arguments(recording, *more)) == 1
    printed = capsys.readouterr()
    assert message in printed.err
    assert "Traceback" not in printed.err


def test_missing_and_broken_files(tmp_path, capsys):
    assert main(arguments(tmp_path / "absent.csv")) == 1
    assert "absent.csv" in capsys.readouterr().err
    broken = tmp_path / "broken.mat"
    broken.write_bytes(b"\x00\x01garbage")
    assert main(arguments(broken)) == 1
    assert "broken.mat" in capsys.readouterr().err


def test_outputs_are_checked_before_the_search(recording, tmp_path, capsys, monkeypatch):
    def search_must_not_start(*args, **kwargs):
        raise AssertionError("the search started")

    monkeypatch.setattr(EffectSearchCV, "fit", search_must_not_start)
    assert main(arguments(recording, "--save", str(tmp_path))) == 1
    assert "folder" in capsys.readouterr().err
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert main(arguments(recording, "--json", str(blocked / "below" / "out.json"))) == 1
    absent = {"jinja2": None}
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: absent.get(name, object()))
    assert main(arguments(recording, "--report", str(tmp_path / "report.md"))) == 1
    assert "skhyst[plot]" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [blocked]


def test_one_output_that_fails_loses_no_other(recording, tmp_path, capsys, monkeypatch):
    def disk_full(*args, **kwargs):
        raise OSError("No space left on device")

    monkeypatch.setattr(joblib, "dump", disk_full)
    assert main(arguments(recording, *files(tmp_path, "report.md"))) == 1
    printed = capsys.readouterr()
    assert "model.joblib cannot be written: No space left" in printed.err
    assert "missing: output_saturation" in printed.out
    assert all((tmp_path / name).stat().st_size > 0 for name in ("out.json", "report.md"))


def test_no_input_and_no_other_file_is_written_over(recording, tmp_path, capsys):
    (tmp_path / "link.json").symlink_to(recording)
    os.link(recording, tmp_path / "hard.json")
    (tmp_path / "mine.json").write_text("mine")
    for output, message, path in (
        (recording, "is an input", recording),
        (tmp_path / "new" / ".." / "hard.json", "is an input", recording),
        (tmp_path / "link.json", "is an input", recording),
        (tmp_path / "mine.json", "exists already: add --force", tmp_path / "mine.json"),
    ):
        old, force = path.read_bytes(), ["--force"] if path == recording else []
        assert main(arguments(recording, "--json", str(output), *force)) == 1
        printed = capsys.readouterr().err
        assert message in printed
        assert printed.count("\n") == 1
        assert path.read_bytes() == old
    both = [str(tmp_path / "one"), "--save", str(tmp_path / "new" / ".." / "one")]
    assert main(arguments(recording, "--json", *both)) == 1
    assert "two outputs" in capsys.readouterr().err
    (tmp_path / "protected").write_text("")
    for checkpoint, message in (
        (tmp_path / "one", "is an input"),  # of the checkpoint, by the output of that name
        (recording, "is an input"),
        (tmp_path / "protected" / "search.skops", "search.skops cannot be written"),
    ):
        more = ["--json", str(tmp_path / "one"), "--checkpoint", str(checkpoint)]
        assert main(arguments(recording, *more)) == 1
        assert message in capsys.readouterr().err
    assert not (tmp_path / "one").exists()


def test_a_file_that_comes_during_the_search_is_kept(recording, tmp_path, capsys, monkeypatch):
    path, fit = tmp_path / "out.json", EffectSearchCV.fit

    def slow(search, *data):
        path.write_text("mine")
        return fit(search, *data)

    monkeypatch.setattr(EffectSearchCV, "fit", slow)
    assert main(arguments(recording, "--json", str(path))) == 1
    assert "exists already" in capsys.readouterr().err
    assert path.read_text() == "mine"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
def test_a_pipe_is_refused_at_once(recording, tmp_path):
    """One that is opened waits for a writer, so that a process of its own is what can be ended."""
    for name in ("pipe.csv", "pipe.skops"):
        os.mkfifo(tmp_path / name)
    calls = (
        arguments(tmp_path / "pipe.csv"),
        arguments(recording, "--json", str(tmp_path / "pipe.csv"), "--force"),
        ["export", str(tmp_path / "pipe.skops"), "--c", str(tmp_path)],
    )
    code = f"from skhyst.cli import main\nprint(*map(main, {calls!r}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout == "1 1 1\n"
    said = done.stderr.splitlines()
    assert len(said) == len(calls)
    assert all("is a" in line for line in said)


def test_interrupt_and_usage_error(recording, monkeypatch):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(EffectSearchCV, "fit", interrupted)
    assert main(arguments(recording)) == 130
    with pytest.raises(SystemExit) as stopped:
        main(["diagnose"])
    assert stopped.value.code == 2


def test_parse_model():
    assert isinstance(parse_model("PrandtlIshlinskii"), PrandtlIshlinskii)
    assert parse_model("prandtl_ishlinskii(n_operators=7)").n_operators == 7
    cascade = parse_model("prandtl_ishlinskii+second_order_mode+second_order_mode")
    assert isinstance(cascade, Cascade)
    names = ["prandtl_ishlinskii", "second_order_mode", "second_order_mode2"]
    assert list(cascade.named_steps) == names


def test_lists(capsys):
    assert main(["models"]) == 0
    assert "prandtl_ishlinskii" in capsys.readouterr().out
    assert main(["effects"]) == 0
    assert "creep" in capsys.readouterr().out


@pytest.mark.slow
def test_demo_finds_what_was_hidden(tmp_path, capsys, monkeypatch):
    few = partial(make_demo_recording, n_records=2)
    monkeypatch.setattr("skhyst.cli._demo.make_demo_recording", few)
    hidden = {name: skhyst.diagnosis.EFFECTS[name] for name in SECRETS}
    monkeypatch.setattr("skhyst.diagnosis._effects.EFFECTS", hidden)
    assert main(["demo", "--output", str(tmp_path / "demo"), "--jobs", "1", "--quiet"]) == 0
    printed = capsys.readouterr().out
    _, secret, _ = make_demo_recording(0, n_records=1)
    assert f"missing: {secret}\n" in printed
    assert f"What had been put in: {secret}" in printed
    names = {path.name for path in (tmp_path / "demo").iterdir()}
    assert names == {"recording.csv", "report.html", "model.joblib", "result.json"}


def test_every_secret_comes_up():
    found = {make_demo_recording(seed, n_records=1)[1] for seed in range(30)}
    assert found == set(SECRETS)


def test_module_runs():
    done = subprocess.run(
        [sys.executable, "-m", "skhyst", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("skhyst ")


def test_units_are_told(recording, tmp_path, capsys):
    path = tmp_path / "out.json"
    assert (
        main(arguments(recording, "--unit", "um=um", "--unit", "volt=V", "--json", str(path))) == 0
    )
    told = capsys.readouterr().out
    result = json.loads(path.read_text())
    assert f"noise floor {result['noise_floor']:#.3g} um" in told
    assert "level 0.4" in told
    assert result["units"] == {"drive": "V", "response": "um", "time": "s"}
    assert result["response_name"] == "um [um]"


def test_without_a_time_it_is_said(recording, tmp_path, capsys):
    path = tmp_path / "rig.csv"
    pd.read_csv(recording).drop(columns="t").to_csv(path, index=False)
    without = arguments(path)
    at = without.index("--time")
    del without[at : at + 2]
    assert main(without) == 0
    assert "sampling interval unknown: give --time or --sampling-rate" in capsys.readouterr().out


def test_a_questionable_time_is_told_in_a_line(recording, tmp_path, capsys):
    path = tmp_path / "counts.csv"
    pd.read_csv(recording).assign(t=range(1000)).to_csv(path, index=False)
    with pytest.warns(TimeUnitWarning):
        read_records(path, drive="volt", time="t")
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert main(arguments(path)) == 0
    assert "skhyst: The time 't' of counts.csv has no unit" in capsys.readouterr().err


def test_options_of_the_search_are_those_of_python(recording, monkeypatch):
    asked = {}

    def fit(search, X, y):
        asked.update(search.get_params())
        raise ValueError("enough")

    monkeypatch.setattr(EffectSearchCV, "fit", fit)
    more = ["--folds", "3", "--washout", "20", "--loss", "huber", "--resample", "0.002"]
    assert main(arguments(recording, *more)) == 1
    names = ("cv", "washout", "loss", "resample")
    assert [asked[name] for name in names] == [3, 20, "huber", 0.002]
    assert main(arguments(recording, "--resample", "auto")) == 1
    assert (asked["cv"], asked["resample"]) == (5, "auto")


def test_every_model_that_is_listed_can_be_declared(capsys):
    assert main(["models"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len({re.match(r"\w+ +", line).end() for line in lines}) == 1  # aligned
    assert len(lines) > 20
    for line in lines:
        model = parse_model(line.split()[0])
        assert not model.operator_class.is_disturbance


@pytest.mark.parametrize("asked", [["--version"], ["--help"], ["diagnose", "--help"]])
def test_what_needs_no_model_is_told_at_once(asked):
    code = (
        "import sys; from skhyst.cli import main\n"
        "try: main()\n"
        "finally: assert not {'numpy', 'pandas', 'sklearn'} & set(sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", code, *asked], capture_output=True, text=True)
    told = f"skhyst {skhyst.__version__}" if asked == ["--version"] else "usage: "
    assert found.stdout.startswith(told)
    assert found.stderr == ""


def test_every_option_that_a_message_names_exists():
    """In a command's own messages, and in those of Python as each command tells them."""
    (commands,) = (a.choices for a in _parser()._actions if a.dest == "subcommand")
    known = {name: {*parser._option_string_actions} for name, parser in commands.items()}
    others = {"_main", "_controllers", "_fmu", "_svg"}  # make options, or name those of others
    for path in Path(skhyst.__file__).parent.rglob("*.py"):
        command = path.stem.removeprefix("_")
        allowed = known.get(command) or set.union(*known.values())
        source = path.read_text(encoding="utf-8")
        if " --" not in source and "(--" not in source and '"--' not in source:
            continue
        nodes = ast.walk(ast.parse(source))
        text = " ".join(str(node.value) for node in nodes if isinstance(node, ast.Constant))
        named = {*re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)}
        assert path.stem in others or named <= allowed, path
    for name, parser in commands.items():
        options = {action.dest for action in parser._actions}
        for parameter in (*_READING, "resample"):
            told = as_options(f"Pass {parameter}='a b', or '{parameter}'.", options)
            command = "diagnose" if "skhyst diagnose" in told else name
            assert {*re.findall(r"--[a-z-]+", told)} <= known[command], told
    shuffled = pd.MultiIndex.from_arrays([[0] * 4, [0.0, 3.0, 2.0, 1.0]], names=["record", "time"])
    with pytest.raises(RecordError, match="sort_index") as raised:
        record_slices(pd.DataFrame({"u": 0.0}, shuffled))
    assert as_options(str(raised.value), options).endswith("in all.")


def test_a_reader_may_leave_early(monkeypatch):
    """As `skhyst models | head -1` does."""

    def leave(options):
        raise BrokenPipeError

    monkeypatch.setattr("skhyst.cli._list.list_models", leave)
    monkeypatch.setattr("os.dup2", lambda *files: None)
    assert main(["models"]) == 0


def test_a_shell_completes_commands(tmp_path):
    pytest.importorskip("argcomplete")
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": "skhyst dia", "COMP_POINT": "10"}
    asked |= {"_ARGCOMPLETE_STDOUT_FILENAME": str(tmp_path / "found"), "_ARGCOMPLETE_IFS": "\n"}
    subprocess.run([sys.executable, "-m", "skhyst"], env=os.environ | asked, check=True)
    assert (tmp_path / "found").read_text().split() == ["diagnose"]


@pytest.mark.slow
def test_subpackages_are_there_when_they_are_asked_for():
    code = (
        "import sys, skhyst; assert 'numpy' not in sys.modules; print(skhyst.diagnosis.EFFECTS)\n"
        "skhyst.inspection; assert 'matplotlib' not in sys.modules"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert "hysteresis" in found.stdout
    assert "diagnosis" in dir(skhyst)
    with pytest.raises(AttributeError, match="no attribute 'magic'"):
        skhyst.magic  # noqa: B018
