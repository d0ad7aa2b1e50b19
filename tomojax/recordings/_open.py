"""Opens a recording in any of its forms."""

from functools import partial
from pathlib import Path
from typing import Any

from tomojax._require import not_installed, require
from tomojax.files import is_mat, open_container
from tomojax.recordings import formats
from tomojax.recordings._described import sidecar
from tomojax.recordings._hdf5 import Hdf5Recording, is_hdf5, variable
from tomojax.recordings._recording import Recording


def open_recording(path: Path | str, **options: Any) -> Recording:
    """Opens a recording: version 1 (HDF5), MATLAB, TDMS, CSV, .npz or MCAP.

    A file of the same name that ends in .toml describes CSV, .npz and MCAP. The description
    has the names of recording version 1's attributes, and `rows`, `columns`, `pitch`,
    `slots`.

    **Arguments:** `options` are `TdmsRecording`'s for .tdms files. Other files have the
    option `header`: fields by name that replace the file's.
    **Raises:** `ValueError`, one line with the file, the field, the value found and the
    value expected; also for a file that cannot be opened.

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
        recording = _opened(path, path.suffix.lower(), options)
    except ModuleNotFoundError as error:
        extra = {"nptdms": "tdms", "mcap": "mcap"}.get(str(error.name), "app")
        told = not_installed(str(error.name), extra)
        raise ValueError(f"{path}: {told}") from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise ValueError(f"{path}: {reason}") from None
    except ValueError as error:
        raise ValueError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    recording.opener = partial(open_recording, path.absolute(), **options)
    return recording


def kind_of(path: Path) -> str:
    """Tells a recording's kind: "contact", or "conductivity" (`tomojax.ert`).

    PATH.toml tells the kind of a table, or the file itself. A file that cannot be read
    counts as "contact"; its reader says what is wrong.

    **Example:**

    >>> from pathlib import Path
    >>> import tomojax as tx
    >>> tx.recordings.kind_of(Path(tx.__file__).with_name("demo.h5"))
    'contact'
    """
    try:
        if told := sidecar(path).get("kind"):
            return str(told)
        with path.open("rb") as raw:
            if not (is_mat(raw) or is_hdf5(raw)):
                return "contact"
        with open_container(path) as file:
            found = file.attributes.get("kind")
            if found is None and "kind" in file.names:
                found = variable(file, "kind")
            return str(found or "contact")
    except (OSError, ValueError, ModuleNotFoundError):
        return "contact"


def _opened(path: Path, suffix: str, options: dict[str, Any]) -> Recording:
    if suffix == ".tdms":
        return formats.TdmsRecording(path, **options)
    own = not options.keys() - {"header"}
    require(own, "options", sorted(options), "header, but for .tdms files")
    header = options.get("header") or {}
    if suffix in (".csv", ".txt", ".tsv", ".npz", ".mcap"):
        opens = {".npz": formats.open_npz, ".mcap": formats.open_mcap}
        return opens.get(suffix, formats.open_csv)(path, header)
    return Hdf5Recording(path, header)
