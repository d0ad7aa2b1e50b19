"""Loads a results file from outside, and judges its contents before any use."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import library, require
from tomojax._shown import html_table, named
from tomojax.files import open_container
from tomojax.methods import DOUBT, fields_of_rows
from tomojax.results.loading._dataset import dataset
from tomojax.results.loading._labels import flag_names, IMAGES, label, parts_of

SCHEMA = "tomojax-results"
VERSION = 1

_ROWS = 1 << 14  # read at once, where few of them are kept

# A covariance is no one's where xy² exceeds xx·yy by more than float32's rounding.
_ROUNDING = 1e-3
_LEAST = 1e-15  # m²; a variance may be below 0 by as little

_EXTRA = "tables"  # brings pandas and xarray


class LoadedResults:
    """An open results file, and a context that closes the file.

    `results["contact_xy"]` gives a dataset as an array; `names` lists the datasets.
    `attributes` are the file's. `rows` is the number of rows, `contacts` the most of a row.
    **Raises:** `ValueError`, one line that names the file and the field.

    **Example:**

    >>> from pathlib import Path
    >>> import tomojax as tx
    >>> try:
    ...     tx.results.LoadedResults(Path("none.h5"))
    ... except ValueError as error:
    ...     print(error)
    none.h5: no results of reconstruct: file: got none, or a folder, expected a file
    """

    def __init__(self, path: Path):
        self.path = path
        try:
            require(path.is_file(), "file", "none, or a folder", "a file")
            self._file = open_container(path)
        except (OSError, ValueError) as error:
            made = "no results of reconstruct"
            raise ValueError(f"{path}: {made}: {error}") from None
        try:
            self._check()
        except (OSError, ValueError) as error:
            self.close()
            raise ValueError(f"{path}: {error}") from None

    def _check(self) -> None:
        file = self._file
        self.attributes: dict[str, Any] = file.attributes
        schema = self.attributes.get("schema")
        require(isinstance(schema, str) and schema == SCHEMA, "schema", "another", SCHEMA)
        version = self.attributes.get("schema_version")
        same = isinstance(version, np.integer) and int(version) == VERSION
        require(same, "schema_version", str(version)[:40], f"{VERSION}")
        shape = file.shape("t")
        require(len(shape) == 1 and shape[0] > 0, "t", f"shape {shape}", "(rows,)")
        self.rows, known = shape[0], fields_of_rows()
        require(file.dtype("t").kind == "f", "t", file.dtype("t"), "float64")
        sizes: dict[str, int] = {}
        for name in [n for n in known if n in file.names]:
            shape, field = file.shape(name), known[name]
            kind = file.dtype(name).kind
            wanted = "f" if np.dtype(field.kind).kind == "f" else "iu"
            require(kind in wanted, name, f"type {file.dtype(name)}", field.kind)
            told = (self.rows, *(sizes.get(s, s) for s in field.sizes))
            fits = len(shape) == len(told) and all(
                size == int(t) for size, t in zip(shape, told) if str(t).isdigit()
            )
            expected = f"({', '.join(map(str, told))})"
            require(fits, name, f"shape {shape}", expected)
            sizes |= dict(zip(field.sizes, shape[1:]))
        self.contacts = sizes.get("C", 0)

    @property
    def names(self) -> list[str]:
        """Returns the names of datasets that can be read."""
        return [n for n in self._file.names if self._file.refused(n) is None]

    def number(self, name: str) -> float:
        """Returns an attribute that is one number above 0, or below."""
        value = self.attributes.get(name)
        one = isinstance(value, np.number) and bool(np.isfinite(value)) and value != 0
        require(one, f"{self.path}: {name}", str(value)[:40], "one number")
        return float(value)  # pyright: ignore

    def size(self) -> np.ndarray:
        """Returns the sheet's size, m."""
        size = np.asarray(self.attributes.get("size"))
        fine = size.shape == (2,) and size.dtype.kind == "f"
        fine = fine and bool(np.isfinite(size).all() and (size > 0).all())
        require(fine, f"{self.path}: size", str(size)[:40], "two lengths, m")
        return size

    def box(self) -> np.ndarray:
        """Returns the lowest and the highest corner of the sheet's box (2, 2), m."""
        size = self.size()
        low = np.asarray(self.attributes.get("origin", 0 * size), float)
        fine = low.shape == (2,) and bool(np.isfinite(low).all())
        require(fine, f"{self.path}: origin", str(low)[:40], "a place, m")
        return np.stack([low, low + size])

    def electrode_xy(self) -> np.ndarray:
        """Returns the electrodes' places (M, 2), m."""
        xy = np.asarray(self.attributes.get("electrode_xy"))
        fine = xy.ndim == 2 and xy.shape[1] == 2 and len(xy) > 0 and xy.dtype.kind in "iuf"
        fine = fine and bool(np.isfinite(xy).all())
        require(fine, f"{self.path}: electrode_xy", f"shape {xy.shape}", "(M, 2), m")
        return xy

    def outline(self) -> list[np.ndarray] | None:
        """Returns closed lines around a sheet that does not fill its box, m; else None."""
        told = self.attributes.get("outline")
        if told is None:
            return None
        try:
            lines = [np.asarray(line, float) for line in json.loads(told)]
            fine = all(line.ndim == 2 and line.shape[1] == 2 for line in lines)
        except (TypeError, ValueError):
            fine, lines = False, []
        require(fine, f"{self.path}: outline", str(told)[:40], "lines (n, 2), m")
        return lines

    def read(self, name: str) -> np.ndarray:
        """Reads a dataset, and checks values that can be wrong."""
        try:
            values = self._file.read_whole(name)
            _check_values(name, values, self.contacts)
        except (OSError, ValueError) as error:
            text = str(error)
            text = text if text.startswith(name) else f"{name}: cannot be read ({text})"
            raise ValueError(f"{self.path}: {text}") from None
        return values

    def __getitem__(self, name: str) -> np.ndarray:
        known = ", ".join(self.names)
        require(name in self.names, f"{self.path}: name", repr(name), f"one of {known}")
        return self.read(name)

    def shape(self, name: str) -> tuple[int, ...]:
        """Returns a dataset's shape."""
        return self._file.shape(name)

    def dtype(self, name: str) -> np.dtype:
        """Returns the type of a dataset's numbers."""
        return self._file.dtype(name)

    def to_pandas(self) -> Any:
        """Returns a DataFrame: a line for each contact of each row, units in the names.

        `contact` counts from 1; a row without contacts has a line of its own, with
        `contact` 0. `doubt` says which to leave out. Images have no column. pandas is an
        extra, `tomojax[tables]`.
        """
        pandas = library("pandas", _EXTRA)
        count = self.read("contact_count").astype(int)
        most = max(1, self.contacts)
        row, at = np.nonzero(np.arange(most) < np.maximum(count, 1)[:, None])
        table = {"row": row, "t_s": self.read("t")[row]}
        table["contact"] = np.where(count[row] > 0, at + 1, 0)
        whole = {}
        for name in self._by_row():
            if name in IMAGES or name == "t":
                continue
            values, unit = self.read(name), self.unit(name)
            if values.ndim == 1:
                whole[label(name, unit=unit)] = values[row]
                continue
            columns = values[row, at].reshape(len(row), -1)
            for k, part in enumerate(parts_of(name)):
                table[label(part, unit=unit)] = columns[:, k]
        if "flags" in whole:
            whole["flag_names"] = flag_names(whole["flags"])
            whole["doubt"] = (whole["flags"] & int(DOUBT)) > 0
        return pandas.DataFrame(table | whole)

    def to_xarray(self) -> Any:
        """Returns a Dataset with the variables, dimensions and units of a NetCDF export.

        All is read into memory, images too. xarray is an extra, `tomojax[tables]`.
        """
        columns = ((name, self.read(name), self.unit(name)) for name in self._by_row())
        told = {n: value for n, value in self.attributes.items() if n != "electrode_xy"}
        return dataset(columns, told, self.size(), self.electrode_xy)

    def _by_row(self) -> list[str]:
        """Returns datasets with an entry for each row, the usual ones first."""
        usual, names = ("t", *fields_of_rows()), self.names
        known = [name for name in usual if name in names]
        known += [name for name in names if name not in usual]
        return [name for name in known if self.shape(name)[:1] == (self.rows,)]

    def stretch(
        self, name: str, start: int | np.integer, stop: int | np.integer
    ) -> np.ndarray:
        """Reads rows `start` to `stop` of a dataset."""
        try:
            return self._file.read(name, int(start), int(stop))
        except (OSError, ValueError) as error:
            told = f"{name}: rows {start} to {stop} cannot be read ({error})"
            raise ValueError(f"{self.path}: {told}") from None

    def row(self, name: str, k: int | np.integer) -> Any:
        """Reads the `k`th row of a dataset."""
        return self.stretch(name, k, int(k) + 1)[0]

    def blocks(
        self, names: Sequence[str], each: int, start: int = 0, stop: int | None = None
    ) -> Iterator[dict[str, np.ndarray]]:
        """Yields datasets by name, `each` rows at a time."""
        stop = self.rows if stop is None else stop
        for at in range(start, stop, each):
            end = min(at + each, stop)
            yield {name: self.stretch(name, at, end) for name in names}

    def thinned(
        self, name: str, step: int, start: int = 0, stop: int | None = None
    ) -> np.ndarray:
        """Reads every `step`-th row of a dataset, from row `start` on."""
        blocks = self.blocks([name], step * max(1, _ROWS // step), start, stop)
        return np.concatenate([block[name][::step] for block in blocks])

    def unit(self, name: str) -> str:
        """Returns a dataset's unit; "1" for numbers without a unit."""
        return str(self.attributes_of(name).get("unit", "1"))

    def attributes_of(self, name: str) -> dict[str, Any]:
        """Returns the attributes of a dataset."""
        return self._file.attributes_of(name)

    def __repr__(self) -> str:
        return named(self, **dict(self._told()), datasets=", ".join(self.names))

    def _repr_html_(self) -> str:
        each = [(n, f"{self.shape(n)} {self.unit(n)}") for n in self.names]
        return html_table([*self._told(), *each], title="Results")

    def _told(self) -> list[tuple[str, str]]:
        method = str(self.attributes.get("method"))
        rows = f"{self.rows} of up to {self.contacts} contacts"
        return [("path", str(self.path)), ("method", method), ("rows", rows)]

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> "LoadedResults":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


def open_results(path: Path | str) -> LoadedResults:
    """Opens a results file to be read.

    **Raises:** `ValueError`, one line that names the file and the field.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> volts = np.asarray(tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15]))
    >>> recording = tx.recordings.ArrayRecording(
    ...     tx.recordings.Rig.of(sensor), volts[None], [0, 15]
    ... )
    >>> settings = tx.results.Settings(method="source", grid=16, contacts=2)
    >>> path = tx.reconstruct_recording(recording, "touch.h5", settings)
    >>> with tx.results.open_results(path) as results:
    ...     places, table = results["contact_xy"], results.to_pandas()
    >>> places.shape
    (1, 2, 2)
    >>> [str(name) for name in table][:5], (1e3 * table.x_m).round().tolist()  # mm
    (['row', 't_s', 'contact', 'x_m', 'y_m'], [30.0])
    """
    return LoadedResults(Path(path))


def _check_values(name: str, values: np.ndarray, contacts: int) -> None:
    if name == "t":
        require(np.isfinite(values).all(), name, "NaN or infinite", "seconds")
    if name == "contact_count":
        most = int(values.max(initial=0))
        fits = most <= contacts and int(values.min(initial=0)) >= 0
        require(fits, name, most, f"0 to {contacts}, as contact_xy has places")
    if name == "contact_covariance":
        xx, yy, xy = np.moveaxis(values.astype(float), -1, 0)
        known = np.isfinite(values).all(-1)
        wrong = (
            (xx < -_LEAST)
            | (yy < -_LEAST)
            | (xy**2 > (1 + _ROUNDING) * xx * yy + _LEAST**2)
        )
        require(not (wrong & known).any(), name, "negative ones", "variances above 0")
