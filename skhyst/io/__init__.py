"""Files as named columns with units: readers of formats and layouts, and recognition of columns.

Nothing here uses an index of record and time: :mod:`skhyst.records` builds it from the columns.
"""

from ._clock import JITTER as JITTER
from ._column_names import SECONDS as SECONDS
from ._column_names import symbol_of as symbol_of
from ._column_names import time_unit_of as time_unit_of
from ._column_names import unit_of as unit_of
from ._column_overview import ColumnOverview
from ._column_overview import inspect_columns as inspect_columns
from ._join import join_files
from ._missing import describe_rows as describe_rows
from ._read_columns import read_columns as read_columns
from ._recognise import RecognisedColumn, recognise_columns
from ._recognise import are_swapped as are_swapped

__all__ = ["ColumnOverview", "RecognisedColumn", "join_files", "recognise_columns"]
