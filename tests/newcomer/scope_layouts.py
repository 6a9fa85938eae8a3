"""Texts in the layouts that makers of oscilloscopes and of data acquisition publish.

Each writer returns a text of a time (s), a first channel (V) and a second one, as the maker's own
software saves them; what it says of the instrument is shortened.

Sources: HIOKI 8807 manual, section 12.5; Yokogawa IM DLM3054-01EN, appendix 3; Beckhoff Infosys,
TE13xx Scope View, "Export in csv"; PI, GCS array data format. The others as files of the instrument
and readers of them in public repositories show them: ControlDesk as LExCI 2 (RWTH Aachen) reads it,
catman (7 lines, then 29 of what there is to say of each channel) as three independent readers do,
LabVIEW as the tests of lvm_read and of its kin do, Tektronix MDO3014 and TDS, Rigol DS1054Z and
DHO804, Siglent SDS1000X-E, Rohde & Schwarz RTB2000, LeCroy HDO and WaveRunner, PicoScope 6.
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


def _text(head, rows):
    return "\n".join([*head, *rows]) + "\n"


def tektronix(t, u, y):
    """MSO, MDO and DPO series: key,value lines, the labels, then TIME,CH1,CH2 and a blank field."""
    head = ["Model,MDO3014", "Firmware Version,1.20", "", "Waveform Type,ANALOG,,"]
    head += ["Point Format,Y,,", "Horizontal Units,s,,", "Horizontal Scale,0.04,,"]
    head += [f"Sample Interval,{t[1] - t[0]:g},,", f"Record Length,{len(t)},,"]
    head += ["Gating,0.0% to 100.0%,,", "Probe Attenuation,1,1,", "Vertical Units,V,V,"]
    head += ["Vertical Offset,0,0,", "Vertical Position,-1.98,0,", ",,,", ",,,", "Label,Amp,Gauge,"]
    return _text([*head, "TIME,CH1,CH2,"], [f"{row}," for row in _rows((t, u, y))])


def tektronix_tds(t, u, y):
    """TDS series: what is said of the record stands beside its first rows; one channel a file."""
    keys = [f"Record Length,{len(t):e},", f"Sample Interval,{t[1]:e},", "Trigger Point,1.0e+02,"]
    keys += [",,", "Source,CH1,", "Vertical Units,V,", "Vertical Scale,5.0e-01,", "Pt Fmt,Y,"]
    keys += ["Horizontal Units,s,", "Probe Atten,1.0e+00,", "Model Number,TDS2014B,"]
    rows = zip([*keys, *[",,"] * (len(t) - len(keys))], t - t[-1] / 2, u, strict=True)
    return _text([], [f"{key},{a:15.9f},{b:10.6f}," for key, a, b in rows])


def keysight(t, u, y):
    """InfiniiVision: the numbers of the channels, then the units in words."""
    return _text(["x-axis,1,2", "second,Volt,Volt"], _rows((t, u, y), "{:+.9E}"))


def rigol(t, u, y):
    """DS1000Z: the number of the row in place of the time, its start and increment in the head."""
    head = ["X,CH1,CH2,Start,Increment,", f"Sequence,Volt,Volt,{t[0]:e},{t[1] - t[0]:e}"]
    return _text(head, [f"{i},{a:.6e},{b:.6e}," for i, (a, b) in enumerate(zip(u, y, strict=True))])


def rigol_mso(t, u, y):
    """MSO5000, DHO800: start and increment of the time behind the names."""
    head = f"CH1V,CH2V,t0 =-5.000000e-02, tInc = {t[1] - t[0]:e},"
    return _text([head], [f"{row},," for row in _rows((u, y))])


def siglent(t, u, y):
    """SDS1000X-E: keys with a value of each channel, sources, and the quantities below them."""
    head = [f"Record Length,Analog:{len(t)},", f"Sample Interval,Analog:{t[1]:E},"]
    head += ["Vertical Units,CH1:V,CH2:V,,", "Horizontal Units,s,", "Model Number,SDS1104X-E,,", ""]
    return _text([*head, "Source,CH1,CH2", "Second,Value,Value"], _rows((t, u, y), "{:+.6E}"))


def rohde_schwarz(t, u, y):
    """RTB2000: each unit behind "in"."""
    return _text(["in s,C1 in V,C2 in V"], _rows((t, u, y), "{:.7E}"))


def lecroy(t, u, y):
    """WaveRunner, HDO: a block on the segments, then Time,Ampl; one channel a file."""
    head = ["LECROYWR640\xb0,12345,Waveform", f"Segments,1,SegmentSize,{len(t)}"]
    head += ["Segment,TrigTime,TimeSinceSegment1", "#1,12-Oct-2020 10:00:00,0                 "]
    return _text([*head, "Time,Ampl"], _rows((t, u)))


def picoscope(t, u, y):
    """PicoScope 6: names, units in parentheses, a blank line; infinite beyond the range."""
    rows = _rows((1e3 * t, u, 1e3 * y), "{:.8f}")
    return _text(["Time,Channel A,Channel B", "(ms),(V),(mV)", ""], rows)


def yokogawa(t, u, y):
    """DLM: keys with a value of each trace, the interval one of them; rows begin with a comma."""
    head = ['"Header Size",11,', '"Model Name","DLM3024",', '"BlockNumber",1,1']
    head += ['"TraceName","CH1","CH2"', f'"BlockSize",{len(t)},{len(t)}', '"VUnit","V","V"']
    head += [f'"SampleRate",{1 / t[1]:e},{1 / t[1]:e}', f'"HResolution",{t[1]:e},{t[1]:e}']
    head += ['"HOffset",-2.0e-01,-2.0e-01', '"HUnit","s","s"', '"Date","2020/10/12","2020/10/12"']
    return _text([*head, ""], [f",{row}" for row in _rows((u, y))])


def hioki(t, u, y):
    """8807 and others: keys, the names on a line of their own, "DATA"."""
    head = ['"COMMENT",', '"8807 MEM DATA"', '"NUM_SIGS",3', f'"INTERVAL",{t[1]:.3E}']
    head += ['"HORZ_UNITS", "S"', '"VERT_UNITS", "S", "V", "V"', '"SIGNAL",']
    return _text([*head, '"TIME", "ACH1", "ACH2"', '"DATA"'], _rows((t, u, y), "{:+.6E}", ", "))


_LABVIEW = ["LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab"]
_LABVIEW += ["Multi_Headings\tNo", "Time_Pref\tRelative", "Operator\tSmith"]
_LABVIEW += ["Date\t2020/10/12", "Time\t10:00:00.123"]


def labview(t, u, y):
    """LabVIEW measurement file (LVM): two heads, an empty last column for comments."""
    n, d = len(t), f"{t[1]:.6f}"
    head = [*_LABVIEW, "X_Columns\tOne", "***End_of_Header***\t", "\t", "Channels\t2\t\t"]
    head += [f"Samples\t{n}\t{n}\t", "Date\t2020/10/12\t2020/10/12\t"]
    head += ["Y_Unit_Label\tVolts\tVolts\t", "X_Dimension\tTime\tTime\t", "X0\t0.0E+0\t0.0E+0\t"]
    head += [f"Delta_X\t{d}\t{d}\t", "***End_of_Header***\t\t\t"]
    return _text(
        [*head, "X_Value\tVoltage_0\tVoltage_1\tComment"], _rows((t, u, y), "{:.6f}", "\t")
    )


def labview_without_time(t, u, y):
    """The same with no column of the time, decimal commas, and no tabs at the ends of lines."""
    n, d = len(t), f"{t[1]:.6f}"
    head = [*_LABVIEW, "X_Columns\tNo", "***End_of_Header***", "", "Channels\t2"]
    head += [f"Samples\t{n}\t{n}", "X_Dimension\tTime\tTime", "X0\t0.0E+0\t0.0E+0"]
    head += [f"Delta_X\t{d}\t{d}", "***End_of_Header***"]
    rows = [f"\t{row}" for row in _rows((u, y), "{:.6f}", "\t")]
    return _text([*head, "X_Value\tVoltage_0\tVoltage_1\tComment"], rows).replace(".", ",")


def labview_with_times(t, u, y):
    """The same with a column of the time before each channel."""
    n, d = len(t), f"{t[1]:.6f}"
    head = [*_LABVIEW, "X_Columns\tMulti", "***End_of_Header***\t", "\t", "Channels\t2\t\t\t"]
    head += [f"Samples\t{n}\t\t{n}\t", "Y_Unit_Label\tVolts\t\tVolts\t"]
    head += ["X_Dimension\tTime\t\tTime\t", f"Delta_X\t{d}\t\t{d}\t"]
    head += ["***End_of_Header***\t\t\t\t", "X_Value\tVoltage_0\tX_Value\tVoltage_1\tComment"]
    return _text(head, _rows((t, u, t, y), "{:.6f}", "\t"))


def catman(t, u, y):
    """HBM catman, text: a head, 29 lines of the channels, a blank line, decimal commas."""
    head = [
        "HBM_CATMAN_DATAFILE_50\t",
        "Test 1\t",
        "\t",
        "\t",
        "\t",
        "Channels:3",
        f"Length: {len(t)}",
    ]
    lines = ["Zeit  1 - Standardmessrate\tKraft\tWeg", "s\tN\tmm", "0\t1\t2", "MX0\tMX1\tMX2"]
    lines += ["\tS-Typ\tWA50", "1000\t1000\t1000", "Hz\tHz\tHz", "Werk\t\tWerk", *["\t\t"] * 21]
    rows = [row.replace(".", ",") for row in _rows((t, u, y), "{:.6f}", "\t")]
    return _text([*head, "", *lines, ""], rows)


def dspace(t, u, y):
    """ControlDesk, CSV: a key before each line of the head and before the first row alone."""
    head = ["header,1.0", "", "trace_names,time,Out1,Out1", "path,,Model Root/Amp,Model Root/Gauge"]
    first, *rows = _rows((t, u, y))
    return _text([*head, "unit,s,V,um"], [f"trace_values,{first}", *[f",{row}" for row in rows]])


def twincat(t, u, y):
    """TwinCAT Scope: a key before each value, a count of the samples before each channel."""
    head = ["Name\tScope Project", "File\tC:\\scope.svdx", ""]
    told = [("Name", "uDrive", "xPos"), ("Data-Type", "REAL64", "REAL64")]
    told += [("SampleTime[ms]", "1", "1"), ("Offset", "0", "0"), ("Unit", "V", "mm")]
    head += ["\t".join((key, a, key, b)) for key, a, b in told]
    rows = [f"{i}\t{a:.6f}\t{i}\t{b:.6f}" for i, (a, b) in enumerate(zip(u, y, strict=True))]
    return _text([*head, ""], [row.replace(".", ",") for row in rows])


def pi_recorder(t, u, y):
    """PI data recorder, GCS array: one name a line, and the interval, each behind a "#"."""
    head = ["# REM E-712", "# VERSION = 1", "# TYPE = 1", "# SEPARATOR = 32", "# DIM = 2"]
    head += [
        f"# SAMPLE_TIME = {t[1]:.6f}",
        f"# NDATA = {len(t)}",
        "# NAME0 = Target Position axis 1",
    ]
    head += ["# NAME1 = Current Position axis 1", "# END_HEADER"]
    return _text(head, _rows((u, y), "{:.6f}", " "))


MAKERS = {
    write.__name__: (write, suffix)
    for suffix, writers in {
        ".csv": (tektronix, tektronix_tds, keysight, rigol, rigol_mso, siglent, rohde_schwarz)
        + (lecroy, picoscope, yokogawa, dspace, twincat),
        ".lvm": (labview, labview_without_time, labview_with_times),
        ".asc": (catman,),
        ".txt": (hioki,),
        ".dat": (pi_recorder,),
    }.items()
    for write in writers
}
