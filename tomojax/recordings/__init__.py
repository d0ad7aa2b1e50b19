"""Reads measured scans, from files or arrays, in chunks, and finds their faults.

The folder reads and judges voltages, and knows nothing of methods. The folder imports no
JAX, so that `tomojax info` starts at once.
"""

from tomojax.recordings._chunks import (
    Chunk as Chunk,
    CHUNK_SLOTS as CHUNK_SLOTS,
    Progress as Progress,
    Rate as Rate,
    read_chunk as read_chunk,
)
from tomojax.recordings._described import (
    number as number,
    sidecar as sidecar,
    size_of as size_of,
)
from tomojax.recordings._faults import Faults as Faults, find_faults as find_faults
from tomojax.recordings._hdf5 import variable as variable
from tomojax.recordings._head import (
    attributes as attributes,
    rig_of as rig_of,
    write_attributes as write_attributes,
)
from tomojax.recordings._open import kind_of as kind_of, open_recording as open_recording
from tomojax.recordings._outline import check_table as check_table, Outline as Outline
from tomojax.recordings._recording import (
    ArrayRecording as ArrayRecording,
    Recording as Recording,
    Rig as Rig,
    SCHEMA as SCHEMA,
    VERSIONS as VERSIONS,
)
from tomojax.recordings._repair import repair_recording as repair_recording
from tomojax.recordings._stretch import between as between

__all__ = [
    "ArrayRecording",
    "between",
    "check_table",
    "Chunk",
    "CHUNK_SLOTS",
    "Faults",
    "find_faults",
    "kind_of",
    "open_recording",
    "Outline",
    "Rate",
    "read_chunk",
    "Recording",
    "repair_recording",
    "Rig",
    "SCHEMA",
    "VERSIONS",
]
