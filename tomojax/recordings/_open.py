"""Opens a recording, whichever form it has."""

from pathlib import Path
from typing import Any

from tomojax._require import require
from tomojax.recordings._recording import Recording


def open_recording(path: Path | str, **options: Any) -> Recording:
    """The recording in a file: version 1 (HDF5), MATLAB v7.3, or TDMS.

    **Arguments:** `options` are those of `TdmsRecording` for .tdms files; for others
    `header`: what attributes of the file should have said, by name.
    **Raises:** `ValueError`, one line with the file, the field, what came and what was
    expected, also for a file that cannot be opened.

    **Example:**

    >>> from pathlib import Path
    >>> import tomojax as tx
    >>> path = Path(tx.__file__).with_name("demo.h5")  # comes with the package
    >>> with tx.open_recording(path) as recording:
    ...     print(recording.scans, recording.slots, recording.electrodes)
    200 3 64
    """
    path = Path(path)
    try:
        if not path.is_file():
            reason = "a folder" if path.is_dir() else "no such file"
            raise ValueError(f"{reason}; give the path of a recording")
        with path.open("rb"):  # for the system's own words, e.g. no permission
            pass
        require(path.stat().st_size > 0, "file", "0 bytes", "a recording")
        if path.suffix.lower() == ".tdms":
            from tomojax.recordings._tdms import TdmsRecording as Reader
        else:
            from tomojax.recordings._hdf5 import Hdf5Recording as Reader

            own = not options.keys() - {"header"}
            require(own, "options", sorted(options), "header, but for .tdms files")
        recording = Reader(path, **options)
    except ModuleNotFoundError as error:
        extra = "tdms" if error.name == "nptdms" else "app"
        raise ValueError(
            f"{path}: {error.name} is not installed; "
            f"pip install 'tomojax[{extra}]' brings it"
        ) from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise ValueError(f"{path}: {reason}") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return recording
