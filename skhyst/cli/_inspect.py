"""`skhyst inspect`: columns, records and faults of recordings."""

from .._files import check_outputs, replacing
from ..inspection import LoopFiguresDisplay, RecordingDisplay
from ..records import inspect_recording
from ._messages import as_options
from ._reading_options import reading_options, sources

_MOST = 20  # loops that are printed


def inspect(options):
    """Print an overview of each recording, and draw one."""
    picture = options.picture
    recordings = sources(options)
    if picture and len(recordings) > 1:
        raise ValueError("A picture is of one recording: --picture with one file.")
    check_outputs([picture] if picture else [], options.files, force=options.force)
    for number, path in enumerate(recordings):
        overview = inspect_recording(path, **reading_options(options))
        print(as_options(f"\n{overview}" if number else str(overview), vars(options)))
        if overview.records:
            loops = LoopFiguresDisplay.from_recording(overview.X, overview.y, draw=False)
            print("\n  ".join(["loops:", *loops.lines(_MOST)]))
    if picture:
        if overview.X is None or overview.y is None:
            raise ValueError(f"{path} is not drawn: its drive and response are not known.")
        display = RecordingDisplay.from_recording(overview.X, overview.y)
        with replacing(picture) as (part,):
            display.figure_.savefig(part)
        print(f"written: {picture}")
