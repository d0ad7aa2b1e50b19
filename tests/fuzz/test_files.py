"""An excerpt of the fuzzer; `python tests/fuzz/files.py --count 5000` is the whole."""

import files
import pytest


@pytest.mark.parametrize(
    "kind",
    ["recording", "swmr", "matlab", "tdms", "results", "calibration", "places_npz"]
    + ["recording_csv", "recording_npz", "recording_mcap", "sidecar"],
)
def test_damaged_files_end_in_a_line(tmp_path, kind):
    if kind == "tdms":
        pytest.importorskip("nptdms")
    found = files.fuzz(tmp_path, [kind], 25, seed=7)[kind]
    assert found.get("read", 0) + found.get("refused", 0) == found["files"], found
