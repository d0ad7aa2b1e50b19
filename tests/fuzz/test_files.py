"""An excerpt of the fuzzer; `python tests/fuzz/files.py --count 5000` is the whole."""

import files
import pytest

# Each damaged file of these starts a process that reads it.
_LONG = (
    "results",
    "swmr",
    "matlab",
    "tdms",
    "calibration",
    "recording_npz",
    "recording_mcap",
)


@pytest.mark.parametrize(
    "kind",
    ["recording", "places_npz", "recording_csv", "sidecar"]
    + [pytest.param(kind, marks=pytest.mark.long) for kind in _LONG],
)
def test_damaged_files_end_in_a_line(tmp_path, kind):
    if kind == "tdms":
        pytest.importorskip("nptdms")
    found = files.fuzz(tmp_path, [kind], 25, seed=7)[kind]
    assert found.get("read", 0) + found.get("refused", 0) == found["files"], found
