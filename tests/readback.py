"""Exports read by other tools, as arrays by the results file's own names."""

import json
from pathlib import Path

import h5py
import numpy as np

PARTS = {
    "contact_x": ("contact_xy", 0),
    "contact_y": ("contact_xy", 1),
}


def results_of(path: Path) -> dict[str, np.ndarray]:
    """The file itself; x and y of places apart, and the covariance's parts."""
    with h5py.File(path) as file:
        found = {name: data[()] for name, data in file.items()}
    found |= {n: found[whole][..., k] for n, (whole, k) in PARTS.items()}
    if "contact_covariance" in found:
        for k, part in enumerate(("xx", "yy", "xy")):
            found[f"contact_covariance_{part}"] = found["contact_covariance"][..., k]
    return found


def _by_contact(columns) -> dict[str, np.ndarray]:
    """contact1_x_m, contact2_x_m, … as contact_x (n, C)."""
    found: dict[str, list] = {}
    for label, values in columns.items():
        head, _, rest = label.partition("_")
        if head.startswith("contact") and head != "contact":
            found.setdefault(rest, []).append(np.asarray(values))
        elif label not in ("flag_names",):
            found[label] = np.asarray(values)
    units = ("s", "m", "m2", "rad", "A", "S", "N", "V")
    made = {}
    for label, values in found.items():
        name, _, unit = label.rpartition("_")
        name = name if unit in units and name else label
        if isinstance(values, list):
            made[f"contact_{name}"] = np.stack(values, 1)
        else:
            made[name] = values
    return made


def csv(path: Path) -> dict[str, np.ndarray]:
    import pandas as pd

    table = pd.read_csv(path, keep_default_na=True)
    found = _by_contact(table.drop(columns="flag_names"))
    # Numbers of a results file are float32, but for the time.
    return {
        name: values.astype(np.float32)
        if values.dtype.kind == "f" and name != "t"
        else values
        for name, values in found.items()
    }


def parquet(path: Path) -> dict[str, np.ndarray]:
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    columns, images = {}, {}
    for name in table.column_names:
        about = table.schema.field(name).metadata or {}
        column = table.column(name).combine_chunks()
        if b"shape" in about:
            shape = json.loads(about[b"shape"])
            images[name] = column.flatten().to_numpy().reshape(-1, *shape)
        elif name != "flag_names":
            columns[name] = column.to_numpy(zero_copy_only=False)
    return _by_contact(columns) | images


def netcdf(path: Path) -> dict[str, np.ndarray]:
    import xarray as xr

    with xr.open_dataset(path, engine="h5netcdf") as data:
        names = ("x", "y", "fine_x", "fine_y", "electrode_x", "electrode_y")
        return {
            str(name): data[name].values
            for name in data.variables
            if not str(name).startswith("event_") and name not in names
        }


def mcap(path: Path) -> dict[str, np.ndarray]:
    """By `mcap`; and by `rosbags`, whose messages are to say the same."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        each = [(c.topic, m) for _, c, _, m in reader.iter_decoded_messages()]
    found, other = _of_messages(each), _of_messages(_by_rosbags(path))
    assert found.keys() == other.keys()
    for name, values in found.items():
        np.testing.assert_array_equal(values, other[name])
    return found


def _by_rosbags(path: Path) -> list:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        return [
            (connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, _, data in reader.messages()
        ]


def _of_messages(each: list) -> dict[str, np.ndarray]:
    states = [m for topic, m in each if topic == "/tomojax/state"]
    images = [m for topic, m in each if topic == "/tomojax/image"]
    most = 4
    found: dict[str, np.ndarray] = {
        "t": np.array([m.device_time for m in states]),
        "contact_count": np.array([len(m.contacts) for m in states]),
        "flags": np.array([m.flags for m in states]),
        "residual": np.array([m.residual for m in states], np.float32),
    }
    for name in ("x", "y", "radius", "angle", "current", "conductance"):
        values = np.full((len(states), most), np.nan, np.float32)
        for k, m in enumerate(states):
            values[k, : len(m.contacts)] = [getattr(c, name) for c in m.contacts]
        found[f"contact_{name}"] = values
    if images:
        found["image"] = np.stack(
            [
                np.frombuffer(bytes(m.data), "<f4").reshape(m.height, m.width)[::-1].T
                for m in images
            ]
        )
    return found


READERS = {"csv": csv, "parquet": parquet, "netcdf": netcdf, "mcap": mcap}
