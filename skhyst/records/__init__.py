"""Records: what the index of X says of time, and reading recordings from files."""

from ._frames import iter_records, stack_records
from ._index import RecordSlice, record_slices, sampling_interval
from ._readers import read_records
from ._resample import resample_records

__all__ = [
    "RecordSlice",
    "iter_records",
    "read_records",
    "record_slices",
    "resample_records",
    "sampling_interval",
    "stack_records",
]
