"""Files whose reading is what is tried: what a newcomer is shown of them is the truth.

Each writer makes the files of a case in a folder and returns their paths; drive and response are
those of :func:`scope_layouts.signals`, 400 samples, one every millisecond.
"""

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


READINGS = {
    "tektronix.csv": Reading(of_maker("tektronix"), "CH1 [V]", "CH2 [V]", ("--drive", "CH1")),
    "keysight.csv": Reading(of_maker("keysight"), "1 [V]", "2 [V]", ("--drive", "1 [V]")),
    "rigol.csv": Reading(of_maker("rigol"), "CH1 [V]", "CH2 [V]", ("--drive", "CH1")),
    "lecroy_two_files": Reading(of_maker("lecroy", files=2), "drive Ampl", "sensor Ampl"),
    "picoscope.csv": Reading(
        of_maker("picoscope"), "Channel A [V]", "Channel B [mV]", ("--drive", "Channel A"), 1e3
    ),
    "labview.lvm": Reading(
        of_maker("labview"), "Voltage_0 [V]", "Voltage_1 [V]", ("--drive", "Voltage_0")
    ),
    "catman.asc": Reading(of_maker("catman"), "Kraft [N]", "Weg [mm]"),
    "dspace.csv": Reading(
        of_maker("dspace"), "Amp/Out1 [V]", "Gauge/Out1 [um]", ("--drive", "Amp/Out1")
    ),
    "dspace.mat": Reading(
        control_desk,
        "Model Root/Amplifier/Out1 [V]",
        "Model Root/Gauge/Out1 [um]",
        ("--drive", "Model Root/Amplifier/Out1"),
    ),
    "force.csv": Reading(
        table({"time [s]": T, "force [N]": U, "displacement [mm]": Y}),
        "force [N]",
        "displacement [mm]",
    ),
    "counted.csv": Reading(
        table({"Tick": np.arange(400), "Ref": U, "Fbk": Y}),
        "Ref",
        "Fbk",
        ("--drive", "Ref", "--sampling-rate", "1000"),
    ),
    "repeated_header.csv": Reading(repeated_header, "voltage", "position", records=2),
    "side_by_side.csv": Reading(side_by_side, "voltage", "position", records=2),
    "field_and_flux": Reading(field_and_flux, "H", "B", ("--drive", "H")),
    "rate_and_units.mat": Reading(matlab_rate_and_units, "u [V]", "y [um]"),
    "four_dimensions.npy": Reading(four_dimensions, refused="(2, 3, 4, 5)"),
    "bench.mf4": Reading(measurement_data_format, refused="asammdf"),
}
