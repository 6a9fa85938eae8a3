"""Texts in the layouts that makers of oscilloscopes and of data acquisition publish.

Each writer returns a text of a time (s), a first channel (V) and a second one, as the maker's own
software saves them; what it says of the instrument is shortened.
"""

import numpy as np

__all__ = ["MAKERS", "signals"]


def signals(n=400, dt=1e-3):
    """Return time (s), a first signal (V) and a second one, rounded as instruments round them."""
    time = dt * np.arange(n)
    u = np.sin(2.0 * np.pi * 5.0 * time) * (0.5 + time)
    y = 0.5 * np.roll(u, 3) + 0.01
    return np.round(time, 9), np.round(u, 6), np.round(y, 6)


def _rows(columns, form="{:.6e}", separator=","):
    return [separator.join(form.format(v) for v in row) for row in zip(*columns, strict=True)]


def tektronix(t, u, y):
    """MSO and MDO series: key,value lines, "Label,,", then TIME,CH1,CH2."""
    head = ["Model,MSO54", "Firmware Version,1.2.3", "", "Waveform Type,ANALOG", "Point Format,Y"]
    head += ["Horizontal Units,s", "Horizontal Scale,0.04", f"Sample Interval,{t[1] - t[0]:g}"]
    head += [f"Record Length,{len(t)}", "Gating,0.0% to 100.0%", "Probe Attenuation,1,1"]
    head += ["Vertical Units,V,V", "Vertical Offset,0,0", "Vertical Scale,0.5,0.5", ",,", ",,"]
    return "\n".join([*head, "Label,,", "TIME,CH1,CH2", *_rows((t, u, y))]) + "\n"


def tektronix_tds(t, u, y):
    """TDS series: what is said of the record stands beside its first rows; one channel a file."""
    keys = [("Record Length", f"{len(t):e}", "Points"), ("Sample Interval", f"{t[1]:e}", "s")]
    keys += [("Trigger Point", "1.0e+02", "Samples"), ("Source", "CH1", ""), ("", "", "")]
    keys += [("Vertical Units", "V", ""), ("Vertical Scale", "0.5", ""), ("Firmware", "v1.0", "")]
    rows = [
        ",".join([*(keys[i] if i < len(keys) else ("", "", "")), f"{a:.6e}", f"{b:.6e}", ""])
        for i, (a, b) in enumerate(zip(t, u, strict=True))
    ]
    return "\n".join(rows) + "\n"


def keysight(t, u, y):
    """InfiniiVision: the numbers of the channels, then the units in words."""
    return "\n".join(["x-axis,1,2", "second,Volt,Volt", *_rows((t, u, y), "{:+.9E}")]) + "\n"


def rigol(t, u, y):
    """DS1000Z: the number of the row in place of the time, its start and increment in the head."""
    rows = [f"{i},{a:.6e},{b:.6e},," for i, (a, b) in enumerate(zip(u, y, strict=True))]
    head = ["X,CH1,CH2,Start,Increment,", f"Sequence,Volt,Volt,{t[0]:e},{t[1] - t[0]:e}"]
    return "\n".join([*head, *rows]) + "\n"


def rigol_mso(t, u, y):
    """MSO5000: start and increment of the time behind the names."""
    head = f"CH1V,CH2V,t0 = {t[0]:e}, tInc = {t[1] - t[0]:e},"
    return "\n".join([head, *[f"{row},," for row in _rows((u, y))]]) + "\n"


def lecroy(t, u, y):
    """WaveRunner, WaveSurfer: a block on the segments, then Time,Ampl; one channel a file."""
    head = ["LECROYWR640,12345,Waveform", f"Segments,1,SegmentSize,{len(t)}"]
    head += ["Segment,TrigTime,TimeSinceSegment1", "#1,12-Oct-2020 10:00:00,0", "Time,Ampl"]
    return "\n".join([*head, *_rows((t, u))]) + "\n"


def picoscope(t, u, y):
    """PicoScope 6: names, units in parentheses, a blank line."""
    head = ["Time,Channel A,Channel B", "(ms),(V),(mV)", ""]
    return "\n".join([*head, *_rows((1e3 * t, u, 1e3 * y), "{:.8f}")]) + "\n"


def labview(t, u, y):
    """LabVIEW measurement file (LVM): two heads, an empty last column for comments."""
    head = ["LabVIEW Measurement", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab"]
    head += ["Decimal_Separator\t.", "Multi_Headings\tNo", "X_Columns\tOne", "Time_Pref\tRelative"]
    head += ["Operator\tSmith", "Date\t2020/10/12", "Time\t10:00:00.123", "***End_of_Header***\t"]
    head += ["", "Channels\t2\t\t\t", f"Samples\t{len(t)}\t{len(t)}\t\t"]
    head += ["Date\t2020/10/12\t2020/10/12\t\t", "Time\t10:00:00.1\t10:00:00.1\t\t"]
    head += [
        "Y_Unit_Label\tVolts\tVolts\t\t",
        "X_Dimension\tTime\tTime\t\t",
        "X0\t0.0E+0\t0.0E+0\t\t",
    ]
    head += [f"Delta_X\t{t[1]:.6f}\t{t[1]:.6f}\t\t", "***End_of_Header***\t\t\t\t"]
    rows = _rows((t, u, y), "{:.6f}", "\t")
    return "\n".join([*head, "X_Value\tVoltage_0\tVoltage_1\tComment", *rows]) + "\n"


def labview_without_time(t, u, y):
    """The same with no column of the time: its increment is in the head."""
    lines = labview(t, u, y).replace("X_Columns\tOne", "X_Columns\tNo").split("\n")
    at = next(i for i, line in enumerate(lines) if line.startswith("X_Value"))
    rows = [f"\t{row}" for row in _rows((u, y), "{:.6f}", "\t")]
    return "\n".join([*lines[: at + 1], *rows]) + "\n"


def catman(t, u, y):
    """HBM catman, text: a head on the channels, names, units, decimal commas."""
    head = ["HBM_CATMAN_DATAFILE_50", "", "Test: 1", f"Channels: 3\tRows: {len(t)}"]
    head += ["Zeit  1 - Standardmessrate\tKraft\tWeg", "s\tN\tmm"]
    return "\n".join([*head, *_rows((t, u, y), "{:.6f}", "\t")]).replace(".", ",") + "\n"


def dspace(t, u, y):
    """ControlDesk, CSV: a keyword before each line of the head, nothing before the rows."""
    head = ['"path","","Model Root/drive/Out1","Model Root/sensor/Out1"', '"unit","s","V","um"']
    head += ['"trace_values","time","drive/Out1","sensor/Out1"']
    return "\n".join([*head, *[f'"",{row}' for row in _rows((t, u, y))]]) + "\n"


MAKERS = {
    name: (write, suffix)
    for name, write, suffix in (
        ("tektronix", tektronix, ".csv"),
        ("tektronix_tds", tektronix_tds, ".csv"),
        ("keysight", keysight, ".csv"),
        ("rigol", rigol, ".csv"),
        ("rigol_mso", rigol_mso, ".csv"),
        ("lecroy", lecroy, ".csv"),
        ("picoscope", picoscope, ".csv"),
        ("labview", labview, ".lvm"),
        ("labview_without_time", labview_without_time, ".lvm"),
        ("catman", catman, ".asc"),
        ("dspace", dspace, ".csv"),
    )
}
