"""Records: the index of record and time, recordings in files, resampling, measurement faults."""

from ._data_quality import data_quality
from ._data_quality import lost_readings as lost_readings
from ._data_quality import with_reactions as with_reactions
from ._frames import iter_records, stack_records
from ._index import MISMATCH as MISMATCH
from ._index import RecordSlice, record_slices, sampling_interval
from ._index import by_interval as by_interval
from ._index import first_of_equals as first_of_equals
from ._index import record_names as record_names
from ._index import refuse_lost_index as refuse_lost_index
from ._index import refuse_masked as refuse_masked
from ._index import valid_interval as valid_interval
from ._lost_rows import fill_lost_rows as fill_lost_rows
from ._lost_rows import with_lost_rows as with_lost_rows
from ._periods import drive_period as drive_period
from ._periods import near_period as near_period
from ._periods import repeats as repeats
from ._read_records import read_records
from ._recording_overview import RecordingOverview, inspect_recording
from ._recording_overview import faults_of_records as faults_of_records
from ._resample import resample_like, resample_records, resampling_error
from ._units import Units

__all__ = [
    "RecordSlice",
    "RecordingOverview",
    "Units",
    "data_quality",
    "inspect_recording",
    "iter_records",
    "read_records",
    "record_slices",
    "resample_like",
    "resample_records",
    "resampling_error",
    "sampling_interval",
    "stack_records",
]
