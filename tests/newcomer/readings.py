"""Files whose reading is what is tried: what a newcomer is shown of them is the truth.

Each writer makes the files of a case in a folder and returns their paths; drive and response are
those of :func:`scope_layouts.signals`, 400 samples, one every millisecond.
"""

import json
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scope_layouts import MAKERS, signals

__all__ = ["READINGS", "Reading"]

T, U, Y = signals()


@dataclass(frozen=True)
class Reading:
    """What writes the files, the options to add, and what must be shown.

    A file that is refused has words of the sentence that mends it in place of the columns.
    """

    write: callable
    drive: str = ""
    response: str = ""
    option: tuple = ()
    factor: float = 1.0  # of the response's unit
    records: int = 1
    interval: str = "0.001 s"
    refused: str = ""

    def fault(self, code, text):
        """Return what is wrong in the exit code and the text of `skhyst inspect`, or ""."""
        if self.refused:
            return "" if self.refused in text and "Traceback" not in text else "not refused"
        wanted = [f"  drive     {self.drive!r}: {U.min():g} to {U.max():g} "]
        low, high = self.factor * Y.min(), self.factor * Y.max()
        wanted += [f"  response  {self.response!r}: {low:g} to {high:g} "]
        found = text.count(f": 400 samples every {self.interval}")
        missing = [line for line in wanted if line not in text]
        return "; ".join([*missing, *[f"{found} records"] * (found != self.records)])


def of_maker(name, *, files=1):
    """Return a writer of a maker's layout, with both channels or one in each file."""
    write, suffix = MAKERS[name]

    def written(folder):
        paths = [folder / f"{one}{suffix}" for one in ("drive", "sensor")[:files]]
        for path, first in zip(paths, (U, Y), strict=False):
            path.write_text(write(T, first, Y), encoding="latin-1")
        return paths

    return written


def table(columns, **options):
    """Return a writer of a table as text."""

    def written(folder):
        pd.DataFrame(columns).to_csv(folder / "bench.csv", index=False, **options)
        return [folder / "bench.csv"]

    return written


def repeated_header(folder):
    """Two recordings below each other, each with its line of names."""
    text = pd.DataFrame({"time": T, "voltage": U, "position": Y}).to_csv(index=False)
    (folder / "runs.csv").write_text(text + text)
    return [folder / "runs.csv"]


def side_by_side(folder):
    """Two recordings beside each other under the same names."""
    frame = pd.DataFrame({"time": T, "voltage": U, "position": Y})
    pd.concat([frame, frame], axis=1).to_csv(folder / "runs.csv", index=False)
    return [folder / "runs.csv"]


def field_and_flux(folder):
    """A magnetic loop, one file for each signal."""
    for name, values in (("H", U), ("B", Y)):
        pd.DataFrame({"t": T, name: values}).to_csv(folder / f"{name}.csv", index=False)
    return [folder / "H.csv", folder / "B.csv"]


def matlab_rate_and_units(folder):
    """A struct with its rate and its units beside the signals."""
    from scipy.io import savemat

    rig = {"u": U, "y": Y, "fs": 1000.0, "units": {"u": "V", "y": "um"}}
    savemat(folder / "rig.mat", {"rig": rig})
    return [folder / "rig.mat"]


def control_desk(folder):
    """ControlDesk, MAT: a struct of the time X and the signals Y with their paths."""
    from scipy.io import savemat

    kinds = [("Name", object), ("Unit", object), ("Data", object)]
    axis = np.array([("Time", "s", T[None])], dtype=kinds)
    told = (("Model Root/Amplifier/Out1", "V", U[None]), ("Model Root/Gauge/Out1", "um", Y[None]))
    savemat(folder / "desk.mat", {"desk_001": {"X": axis, "Y": np.array(list(told), dtype=kinds)}})
    return [folder / "desk.mat"]


def four_dimensions(folder):
    """An array of which nobody knows what its axes are."""
    np.save(folder / "scan.npy", np.zeros((2, 3, 4, 5)))
    return [folder / "scan.npy"]


def measurement_data_format(folder):
    """A format that another package reads."""
    (folder / "bench.mf4").write_bytes(b"MDF     4.10    ")
    return [folder / "bench.mf4"]


def simulink_structure(folder):
    """What "To Workspace" saves as a structure with time."""
    from scipy.io import savemat

    kinds = [("values", object), ("label", object)]
    signals = np.array([(U[:, None], "command"), (Y[:, None], "position")], dtype=kinds)
    savemat(folder / "sim.mat", {"out": {"time": T[:, None], "signals": signals}})
    return [folder / "sim.mat"]


def signals_in_rows(folder):
    """What "To File" of Simulink saves."""
    from scipy.io import savemat

    savemat(folder / "sim.mat", {"ans": np.vstack([T, U, Y])})
    return [folder / "sim.mat"]


def channel_groups(folder):
    """HDF5 with a group for each channel."""
    import h5py

    with h5py.File(folder / "daq.h5", "w") as file:
        file.attrs["sample_rate"] = 1000.0
        for name, values, unit in (("command", U, "V"), ("position", Y, "um")):
            file[f"daq/{name}/data"] = values
            file[f"daq/{name}/data"].attrs["unit"] = unit
    return [folder / "daq.h5"]


def serial_monitor(folder):
    """What a microcontroller prints, with the time at which it arrived."""
    rows = zip(_stamps("%H:%M:%S.%f"), U, Y, strict=True)
    text = "".join(f"{stamp[:-3]} -> {u},{y}\n" for stamp, u, y in rows)
    (folder / "log.txt").write_text(text)
    return [folder / "log.txt"]


def _stamps(form):
    start = pd.Timestamp("2024-05-31 13:00:00")
    return [(start + pd.Timedelta(t, unit="s")).strftime(form) for t in T]


def keyence(folder):
    """A displacement sensor's program: the cycle of sampling with its unit beside it, numbers."""
    rows = "".join(f"{i},{u:+f},{y:+f}\n" for i, (u, y) in enumerate(zip(U, Y, strict=True)))
    head = "LK-Navigator\nSampling Cycle,1000,us\nNumber,OUT1,OUT2\n"
    (folder / "laser.csv").write_text(head + rows)
    return [folder / "laser.csv"]


def aligned_comments(folder):
    """A simulation's export: names with blanks, aligned, in the last of its comment lines."""
    head = "% Model: stage.mph\n% Time (s)     Voltage (V)     Displacement (um)\n"
    rows = "".join(f"{t:g}   {u}   {y}\n" for t, u, y in zip(T, U, Y, strict=True))
    (folder / "export.txt").write_text(head + rows)
    return [folder / "export.txt"]


def rate_in_a_comment(folder):
    """The rate in kHz above the names."""
    rows = "".join(f"{u}\t{y}\n" for u, y in zip(U, Y, strict=True))
    (folder / "rate.txt").write_text("# fs = 1 kHz\n# u [V]\ty [um]\n" + rows)
    return [folder / "rate.txt"]


def numbered_side_by_side(folder):
    """Two recordings beside each other, whose names are numbered."""
    pd.DataFrame({"t1": T, "u1": U, "y1": Y, "t2": T, "u2": U, "y2": Y}).to_csv(
        folder / "runs.csv", index=False
    )
    return [folder / "runs.csv"]


def titled(folder):
    """Two recordings below each other, with a line between them."""
    frame = pd.DataFrame({"time": T, "voltage": U, "position": Y})
    rows = frame.to_csv(index=False, header=False)
    (folder / "runs.csv").write_text(f"time,voltage,position\n{rows}\nRun 2\n{rows}")
    return [folder / "runs.csv"]


def over_midnight(folder):
    """Times of day, the last of them on the next day."""
    stamps = pd.Timestamp("2024-05-31 23:59:59.900") + pd.to_timedelta(T, unit="s")
    frame = pd.DataFrame({"Uhrzeit": stamps.strftime("%H:%M:%S,%f").str[:-3], "V": U, "mm": Y})
    frame.to_csv(folder / "night.csv", index=False, sep=";", decimal=",")
    return [folder / "night.csv"]


def serial_plotter(folder):
    """What a microcontroller prints for a plotter: each reading with its label."""
    rows = zip(np.round(1e3 * T).astype(int), U, Y, strict=True)
    text = "".join(f"t_ms:{t},cmd:{u},pos:{y}\n" for t, u, y in rows)
    (folder / "plot.txt").write_text(f"Ready.\n{text}")
    return [folder / "plot.txt"]


def json_lines(folder):
    """A logger's JSON, a record in each line, with a record inside."""
    rows = zip(T.tolist(), U.tolist(), Y.tolist(), strict=True)
    lines = [json.dumps({"t": t, "command": u, "sensor": {"position": y}}) for t, u, y in rows]
    (folder / "log.jsonl").write_text("\n".join(lines))
    return [folder / "log.jsonl"]


def time_series_objects(folder):
    """A struct for each signal, with its times."""
    from scipy.io import savemat

    pairs = (("command", U), ("position", Y))
    savemat(folder / "s.mat", {name: {"Time": T, "Data": values} for name, values in pairs})
    return [folder / "s.mat"]


def grouped(values):
    """Return numbers as text with points between thousands and a decimal comma."""
    return [f"{v:,.6f}".translate(str.maketrans(",.", ".,")) for v in values]


READINGS = {
    "tektronix.csv": Reading(of_maker("tektronix"), "CH1 [V]", "CH2 [V]", ("--drive", "CH1")),
    "keysight.csv": Reading(of_maker("keysight"), "1 [V]", "2 [V]", ("--drive", "1 [V]")),
    "rigol.csv": Reading(of_maker("rigol"), "CH1 [V]", "CH2 [V]", ("--drive", "CH1")),
    "siglent.csv": Reading(of_maker("siglent"), "CH1 [V]", "CH2 [V]", ("--drive", "CH1")),
    "rohde_schwarz.csv": Reading(
        of_maker("rohde_schwarz"), "C1 in V", "C2 in V", ("--drive", "C1")
    ),
    "lecroy_two_files": Reading(of_maker("lecroy", files=2), "drive Ampl", "sensor Ampl"),
    "picoscope.csv": Reading(
        of_maker("picoscope"), "Channel A [V]", "Channel B [mV]", ("--drive", "Channel A"), 1e3
    ),
    "hioki.txt": Reading(of_maker("hioki"), "ACH1 [V]", "ACH2 [V]", ("--drive", "ACH1")),
    "yokogawa.csv": Reading(of_maker("yokogawa"), "CH1 [V]", "CH2 [V]", ("--drive", "CH1")),
    "labview.lvm": Reading(
        of_maker("labview"), "Voltage_0 [V]", "Voltage_1 [V]", ("--drive", "Voltage_0")
    ),
    "labview_times.lvm": Reading(
        of_maker("labview_with_times"),
        "Voltage_0 [V]",
        "Voltage_1 [V]",
        ("--drive", "Voltage_0"),
    ),
    "catman.asc": Reading(of_maker("catman"), "Kraft [N]", "Weg [mm]"),
    "pi_recorder.dat": Reading(
        of_maker("pi_recorder"), "Target Position axis 1", "Current Position axis 1"
    ),
    "twincat.csv": Reading(of_maker("twincat"), "uDrive [V]", "xPos [mm]"),
    "dspace.csv": Reading(
        of_maker("dspace"),
        "Model Root/Amp/Out1 [V]",
        "Model Root/Gauge/Out1 [um]",
    ),
    "dspace.mat": Reading(
        control_desk,
        "Model Root/Amplifier/Out1 [V]",
        "Model Root/Gauge/Out1 [um]",
    ),
    "force.csv": Reading(
        table({"time [s]": T, "force [N]": U, "displacement [mm]": Y}),
        "force [N]",
        "displacement [mm]",
    ),
    "german.csv": Reading(
        table(
            {"Zeit in ms": 1e3 * T, "Kraft in N": U, "Weg in mm": Y},
            sep=";",
            decimal=",",
            encoding="cp1252",
        ),
        "Kraft in N",
        "Weg in mm",
    ),
    "spanish.csv": Reading(
        table({"posición": Y, "voltaje": U, "tiempo": T}), "voltaje", "posición"
    ),
    "no_header.txt": Reading(
        table({0: T, 1: U, 2: Y}, sep="\t", header=False), "1", "2", ("--drive", "1")
    ),
    "german_dates.csv": Reading(
        table({"Zeitstempel": _stamps("%d.%m.%Y %H:%M:%S,%f"), "U": U, "x": Y}, sep=";"), "U", "x"
    ),
    "american_dates.csv": Reading(
        table({"Date": _stamps("%m/%d/%Y %I:%M:%S.%f %p"), "volts": U, "stroke": Y}),
        "volts",
        "stroke",
    ),
    "since_1970.csv": Reading(
        table({"timestamp": 1717156800000 + np.round(1e3 * T).astype(int), "cmd": U, "pos": Y}),
        "cmd",
        "pos",
    ),
    "millis.csv": Reading(
        table({"millis": np.arange(400), "pwm": U, "angle_deg": Y}), "pwm", "angle_deg"
    ),
    "serial_monitor.txt": Reading(serial_monitor, "1", "2", ("--drive", "1")),
    "two_indexes.csv": Reading(
        table({"": np.arange(400), "time": T, "setpoint": U, "measured": Y}),
        "setpoint",
        "measured",
    ),
    "magnetic.csv": Reading(table({"t (s)": T, "H (A/m)": U, "B (T)": Y}), "H (A/m)", "B (T)"),
    "heater.csv": Reading(
        table({"t [s]": T, "power [W]": U, "temperature [°C]": Y}), "power [W]", "temperature [°C]"
    ),
    "damper.csv": Reading(
        table({"t": T, "disp": U, "vel": np.gradient(U), "current": 0.0 * U, "force": Y}),
        "disp",
        "force",
        ("--drive", "disp"),
    ),
    "counted.csv": Reading(
        table({"Tick": np.arange(400), "Ref": U, "Fbk": Y}),
        "Ref",
        "Fbk",
        ("--sampling-rate", "1000"),
    ),
    "repeated_header.csv": Reading(repeated_header, "voltage", "position", records=2),
    "side_by_side.csv": Reading(side_by_side, "voltage", "position", records=2),
    "numbered_side_by_side.csv": Reading(numbered_side_by_side, "u1", "y1", records=2),
    "titled.csv": Reading(titled, "voltage", "position", records=2),
    "over_midnight.csv": Reading(over_midnight, "V", "mm"),
    "serial_plotter.txt": Reading(serial_plotter, "cmd", "pos"),
    "log.jsonl": Reading(json_lines, "command", "sensor.position"),
    "time_series.mat": Reading(time_series_objects, "command.Data", "position.Data"),
    "dashes.csv": Reading(
        table({"t_ms": T, "voltage": U, "position": [*Y[:-2].astype(str), "---", "OL"]}),
        refused="2 row(s) (398, 399). Pass --on-missing drop or --on-missing interpolate",
    ),
    "heater_current.csv": Reading(
        table({"t": T, "command": U**2, "current": U, "temperature": Y}),
        "current",
        "temperature",
        ("--drive", "current"),
    ),
    "field_and_flux": Reading(field_and_flux, "H", "B", ("--drive", "H")),
    "rate_and_units.mat": Reading(matlab_rate_and_units, "u [V]", "y [um]"),
    "simulink.mat": Reading(simulink_structure, "command", "position"),
    "to_file.mat": Reading(signals_in_rows, "ans[1, :]", "ans[2, :]", ("--drive", "ans[1, :]")),
    "channel_groups.h5": Reading(channel_groups, "daq/command/data [V]", "daq/position/data [um]"),
    "chinese.csv": Reading(
        table({"时间(s)": T, "电压(V)": U, "位移(μm)": Y}, encoding="gb18030"),
        "电压(V)",
        "位移(μm)",
    ),
    "japanese.csv": Reading(
        table({"時間[s]": T, "電圧[V]": U, "変位[μm]": Y}, encoding="shift_jis"),
        "電圧[V]",
        "変位[μm]",
    ),
    "korean.csv": Reading(
        table({"시간(s)": T, "전압(V)": U, "변위(mm)": Y}, encoding="cp949"), "전압(V)", "변위(mm)"
    ),
    "russian.csv": Reading(
        table({"Время, с": T, "Напряжение, В": U, "Ход, мкм": Y}, sep=";", encoding="cp1251"),
        "Напряжение, В",
        "Ход, мкм",
        ("--drive", "Напряжение, В"),
    ),
    "polish.csv": Reading(
        table({"Czas [s]": T, "Napięcie [V]": U, "Położenie [µm]": Y}, sep=";", encoding="cp1250"),
        "Napięcie [V]",
        "Położenie [µm]",
    ),
    "rate.txt": Reading(rate_in_a_comment, "u [V]", "y [um]"),
    "comments.txt": Reading(aligned_comments, "Voltage (V)", "Displacement (um)"),
    "clock_with_commas.csv": Reading(
        table({"Uhrzeit": _stamps("%H:%M:%S,%f"), "Sollwert": U, "Istwert": Y}, sep=";"),
        "Sollwert",
        "Istwert",
    ),
    "thousands.csv": Reading(
        table({"Zeit [s]": T, "Kraft [N]": U, "Weg [mm]": grouped(1e4 * Y)}, sep=";", decimal=","),
        "Kraft [N]",
        "Weg [mm]",
        factor=1e4,
    ),
    "times_of_each.csv": Reading(
        table({"Time_1": T, "voltage": U, "Time_2": T, "position": Y}), "voltage", "position"
    ),
    "keyence.csv": Reading(keyence, "OUT1", "OUT2", ("--drive", "OUT1")),
    "four_dimensions.npy": Reading(four_dimensions, refused="(2, 3, 4, 5)"),
    "bench.mf4": Reading(measurement_data_format, refused="asammdf"),
}
