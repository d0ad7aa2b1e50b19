"""Writes recordings of pairs: HDF5, MATLAB's file, or a table with its description."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import one_of, require
from tomojax._whole import whole, write_text

Arrays = dict[str, np.ndarray]


def save_as(path: Path, arrays: Arrays, told: dict[str, Any]) -> None:
    """Writes arrays and attributes by the path's ending.

    **Raises:** `ValueError` for an ending that no format has.
    """
    ending = path.suffix.lower()
    require(ending in _WRITERS, "path", f"{path}", f"an ending {one_of(ending, _WRITERS)}")
    _WRITERS[ending](path, arrays, told)


def _hdf5(path: Path, arrays: Arrays, told: dict[str, Any]) -> None:
    import h5py

    n, c, _ = arrays["v"].shape
    with whole(path) as part, h5py.File(part, "w") as file:
        file.attrs.update(told)
        for name, values in arrays.items():
            file[name] = values
        file["condition"] = np.broadcast_to(np.arange(c, dtype=np.uint16), (n, c))


def _mat(path: Path, arrays: Arrays, told: dict[str, Any]) -> None:
    from scipy.io import savemat

    short = {name.removeprefix("conditions/"): a for name, a in arrays.items()}
    with whole(path) as part:
        savemat(part, told | short, do_compression=True)


def _csv(path: Path, arrays: Arrays, told: dict[str, Any]) -> None:
    arrays = dict(arrays)
    volts, inject, read = (
        arrays.pop(n) for n in ("v", "conditions/inject", "conditions/read")
    )
    names = [f"i{a}-{b}_v{p}-{m}" for (a, b), some in zip(inject, read) for p, m in some]
    columns = {"t_s": arrays.pop("t0")}
    if "places" in arrays:
        columns["x_m"], columns["y_m"] = arrays.pop("places").T
    rows = np.column_stack([*columns.values(), volts.reshape(len(volts), -1)])
    with whole(path) as part:
        head = ",".join([*columns, *names])
        np.savetxt(part, rows, "%.9g", ",", header=head, comments="")
    told = told | {"inject": inject, "read": read} | arrays
    # Texts, numbers and lists are written alike in JSON and in TOML.
    lines = [f"{name} = {json.dumps(np.asarray(a).tolist())}" for name, a in told.items()]
    write_text(path.with_suffix(".toml"), "\n".join(lines) + "\n")


_WRITERS: dict[str, Callable] = {".h5": _hdf5, ".hdf5": _hdf5, ".mat": _mat, ".csv": _csv}
