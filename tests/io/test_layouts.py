"""Texts in every layout are read as they were written, or refused with what would settle it."""

import numpy as np
import pandas as pd
import pytest
from text_layouts import draw_layout, judge

from skhyst.exceptions import RecordError
from skhyst.io._column_names import time_unit_of
from skhyst.io._text import parse_table
from skhyst.records import read_records


def read(folder, text, **options):
    """Return all columns of numbers of a text."""
    path = folder / "rig.csv"
    path.write_text(text)
    first = read_records(path, drive=0, **options)[0]
    columns = [first.iloc[:, 0].tolist()]
    while True:
        try:
            X, _ = read_records(path, drive=len(columns), **options)
        except RecordError as error:
            assert "no column at position" in str(error)  # noqa: PT017
            return columns
        columns.append(X.iloc[:, 0].tolist())


def refused(folder, text, message, **options):
    path = folder / "rig.csv"
    path.write_text(text)
    with pytest.raises(RecordError, match=message):
        read_records(path, drive=0, **options)


@pytest.mark.slow
def test_no_layout_is_read_wrongly(tmp_path):
    verdicts = []
    for number in range(60):
        data, truth, names = draw_layout(np.random.default_rng([1, number]))
        path = tmp_path / "rig.txt"
        path.write_bytes(data)
        verdicts.append(judge(path, truth, names))
    assert "wrong" not in verdicts
    assert verdicts.count("right") > 0.9 * len(verdicts)  # 97 % less three deviations


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("0,5\t1\n1,25\t2\n", [[0.5, 1.25], [1.0, 2.0]]),
        ("0,5 1 7\n1,25 2 8\n", [[0.5, 1.25], [1.0, 2.0], [7.0, 8.0]]),
        ("0,5\t1.5\n1,25\t2.25\n", [[0.5, 1.25], [1.5, 2.25]]),  # each column has its own sign
        ("u\n0,5\n1,25\n", [[0.5, 1.25]]),
        ("0,05\n1,25\n", [[0.05, 1.25]]),  # no column has 05 in it
        ("1.5\n2.5\n", [[1.5, 2.5]]),
        ('"0,5","1"\n"1,25","2"\n', [[0.5, 1.25], [1.0, 2.0]]),
        ("t,u\n0,5\n1,25\n", [[0.0, 1.0], [5.0, 25.0]]),
        ("t;u\n0;1,5\n1;2,5\n# end\nStopped by user\n", [[0.0, 1.0], [1.5, 2.5]]),
        ("t,u\n0,1.5\n1,2.5\nmean,2.0\n", [[0.0, 1.0], [1.5, 2.5]]),
        ("Gain;2\nRate;1000\n\nt;u\n0;1,5\n1;2,5\n", [[0.0, 1.0], [1.5, 2.5]]),
        ("t;u\n0;1,5\n1;2,5\n;\n;\n", [[0.0, 1.0], [1.5, 2.5]]),
        ("t;u\n0;1,5\n1;2,5\nt;u\n", [[0.0, 1.0], [1.5, 2.5]]),  # a second record never begun
        ("t;u\n1.0D+01;\N{MINUS SIGN}2.5\n2.0D+01;3.5\n", [[10.0, 20.0], [-2.5, 3.5]]),
        ("0,5;1,5;\n1,25;2,5;\n", [[0.5, 1.25], [1.5, 2.5]]),  # every line ends in a delimiter
    ],
)
def test_what_is_no_doubt_is_read(tmp_path, text, columns):
    assert read(tmp_path, text) == columns


@pytest.mark.parametrize(
    ("text", "settled", "columns"),
    [
        ("0,5\n1,25\n", {"decimal": ","}, [[0.5, 1.25]]),
        ("0,5\n1,25\n", {"delimiter": ","}, [[0.0, 1.0], [5.0, 25.0]]),
        ("1,2,5\n2,3,5\n", {"delimiter": ","}, [[1.0, 2.0], [2.0, 3.0], [5.0, 5.0]]),
        ("t,u,y\n0,1,1,5,2\n1,2,1,5,2\n", {}, None),
        ("1,250;20,125\n2,250;21,125\n", {"decimal": ","}, [[1.25, 2.25], [20.125, 21.125]]),
        ("run 1,5\nrun 2,5\n", {"decimal": ","}, None),
        ("u;y\n1;3.002\n6;831\n", {"decimal": ","}, [[1.0, 6.0], [3002.0, 831.0]]),
        ("u;y\n1;3.002\n6;831\n", {"decimal": "."}, [[1.0, 6.0], [3.002, 831.0]]),
    ],
)
def test_what_is_in_doubt_is_refused_with_what_settles_it(tmp_path, text, settled, columns):
    refused(tmp_path, text, "delimiter=','|decimal=','")
    if columns:
        assert read(tmp_path, text, **settled) == columns


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t;u\n0;1\n1;2\n\nt;v\n0;1\n1;2\n", "Got 't' in row 2"),  # two tables
        ("t;u\n0;1\n1;2\n3;oops;4\n5;6\n", "oops"),
        ("t;u\n0;1\n1;2\n2,5\n", "line 4, '2,5', below the table"),
        ("t,u,y\n0,1,2\n1,2,3\nt,y,u\n0,1,2\n", "'t,y,u' within it .* another order"),
        ("t,u [V]\n0,1\n1,2\nt,u [mV]\n0,1\n", "'t,u .mV.' within it .* other units"),
        ("t,u,y\n0.0 s,1.5 V,2 um\n0.1 s,2.5 V,3 um\n", "hold units, as '0.0 s'"),
        ("t;u\n0;1;1\n1;2\n2;3\n3;4\n", "0 1 1"),
        ("0;1\n0.1;1.5\n0.2;1.6\n", "may number the columns"),
        ("t;u\n" + "0;1,5\n" * 20_000 + "5,1\n", "below the table"),
    ],
)
def test_rows_that_are_none_are_refused(tmp_path, text, message):
    refused(tmp_path, text, message)


@pytest.mark.slow
def test_a_footer_behind_many_rows_is_left_out(tmp_path):
    (column, _) = read(tmp_path, "t;u\n" + "0,25;1,5\n" * 20_000 + "End of file\n")
    assert column == [0.25] * 20_000


@pytest.mark.parametrize("columns", [{"drive": 0}, {"drive": 1, "time": 0}])
def test_an_integer_beyond_floating_point_is_refused(tmp_path, columns):
    (tmp_path / "a.csv").write_text(f"0;1\n1{'0' * 400};2\n")
    with pytest.raises(RecordError, match="beyond all floating-point numbers"):
        read_records(tmp_path / "a.csv", **columns)


def test_a_value_by_name_below_labels_is_no_row(tmp_path):
    (tmp_path / "a.csv").write_text("run0 2.5\nrun1 3.5\nmean: 3.0\n")
    assert read_records(tmp_path / "a.csv", drive=1)[0].iloc[:, 0].tolist() == [2.5, 3.5]
    (tmp_path / "b.csv").write_text("one: 2.5\ntwo: 3.5\nmean: 3.0\n")
    assert read_records(tmp_path / "b.csv", drive=1)[0].iloc[:, 0].tolist() == [2.5, 3.5, 3.0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"delimiter": ", "}, "'delimiter' parameter .* one character"),
        ({"delimiter": 3}, "'delimiter' parameter .* Got 3"),
        ({"decimal": ";"}, "'decimal' parameter .* Got ';'"),
    ],
)
def test_options_are_checked(tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, "t,u\n0,1\n", **options)
    np.save(tmp_path / "a.npy", np.arange(3.0))
    with pytest.raises(ValueError, match="no delimited text"):
        read_records(tmp_path / "a.npy", drive=0, decimal=",")
    with pytest.raises(ValueError, match="the frame"):
        read_records(pd.DataFrame({"u": [1.0, 2.0]}), drive="u", delimiter=";")


@pytest.mark.parametrize("footer", ["", "Stopped by user\n"])
def test_a_line_of_units_is_read_under_every_layout(tmp_path, footer):
    path = tmp_path / "rig.csv"
    path.write_text(f"Rig 7\nt;u;y;\nms;[V];-;\n0;1,5;2;\n1;2,5;3;\n{footer}")
    X, y = read_records(path, drive="u", response="y", time="t", delimiter=";", decimal=",")
    assert (X.columns.tolist(), y.name) == (["u [V]"], "y")
    assert X.index.get_level_values("time").tolist() == [0.0, 0.001]
    assert X["u [V]"].tolist() == [1.5, 2.5]


@pytest.mark.parametrize(
    ("text", "names", "seconds"),
    [
        ("t [s],u,y,t [ms],u,y\n0,1,2,0,2,1\n0.5,2,3,500,1,4\n", "u y", [0, 0.5, 0, 0.5]),
        ("ms,V,um\nt,u,y\n0,1,2\n0.5,2,3\n", "u [V] y [um]", [0, 5e-4]),
        ("t [s]   u [V]   y [um]\n 0.0   1.5   2.0\n 0.5  2.0  3\n", "u [V] y [um]", [0, 0.5]),
        ("t,u,y\n11:59:59.0 PM,0,0\n11:59:59.5 PM,1,2\n12:00:00.0 AM,2,3\n", "u y", [0, 0.5, 1]),
        ("t,u,y\n59:59.0,1,2\n59:59.5,2,3\n00:00.0,2,3\n", "u y", [0, 0.5, 1]),
        (
            "t,u,y\n05/06/2024 23:59:58,0,1\n05/06/2024 23:59:59,1,2\n05/07/2024 0:00:00,2,3\n",
            "u y",
            [0, 1, 2],
        ),
        ("t,u,y\n31.05.24 23:59:59,1,2\n01.06.24 00:00:00,2,3\n", "u y", [0, 1]),
        ("t,u,y\n31-May-2024 23:59:59,1,2\n01-Jun-2024 0:00:00,2,3\n", "u y", [0, 1]),
    ],
)
def test_units_and_times_are_read_as_written(tmp_path, text, names, seconds):
    (tmp_path / "rig.csv").write_text(text)
    X, y = read_records(tmp_path / "rig.csv", drive="u", response="y", time="t")
    assert f"{X.columns[0]} {y.name}" == names
    if "t [s],u,y,t [ms]" in text:  # one record is not left out in silence
        with pytest.raises(RecordError, match=r"no column 't \[s\]'"):
            read_records(tmp_path / "rig.csv", drive="u", response="y", time="t [s]")
    times = X.index.get_level_values("time")
    if times.dtype.kind != "f":
        times = (times - times[0]).total_seconds()
    assert times.tolist() == seconds


@pytest.mark.parametrize(
    ("head", "rate"),
    [
        ("Sampling period 0.002", 500),
        ("Abtastrate;500;Hz", 500),
        ("Rate: 500 Hz", 500),
        ("Rate: 500", None),  # of what
        ("Acquisition rate: 500 S/s", 500),
        ("Sampling Rate: 0.5 kS/s", 500),
        ("Delta t [ms]: 2", 500),
        ("Scan interval = 2 msec", 500),
        ("Scan interval = 2 mm", None),
        ("Sample Time 0.002 s", 500),
        ("Samples per second: 500", 500),
        ("Sampling Rate: 1,000 Hz", 1000),
        ("Drive frequency: 10 Hz", None),
    ],
)
def test_a_rate_above_the_table_is_read_if_a_word_and_its_unit_give_it(head, rate):
    ((*_, interval),) = parse_table(f"{head}\nu,y\n0.5,1.5\n1.5,2.5\n")
    assert interval == (rate and pytest.approx(1 / rate))


@pytest.mark.parametrize(
    ("name", "unit"), [("timeMS", "ms"), ("elapsedMillis", "ms"), ("times", ""), ("fieldH", "")]
)
def test_the_unit_of_a_time_is_read_from_its_last_word(name, unit):
    assert time_unit_of(name) == unit
