"""Reads recordings in the formats of other tools.

Each module reads one kind of file into a `Recording`.
"""

from tomojax.recordings.formats._csv import open_csv as open_csv
from tomojax.recordings.formats._mcap import open_mcap as open_mcap
from tomojax.recordings.formats._npz import open_npz as open_npz
from tomojax.recordings.formats._tdms import TdmsRecording as TdmsRecording
