"""Recordings for tests: written field by field, so that any field can be wrong."""

import h5py
import numpy as np

ATTRIBUTES = {
    "schema": "tomojax-recording",
    "schema_version": 1,
    "f_switch": 10e3,
    "scale": 5 / 32768,
    "offset": 0.0,
    "drive_voltage": 4.5,
    "ground_resistance": 4.0,
    "sheet_resistance": 10e3,
    "size": [0.16, 0.16],
    "electrode_diameter": 0.005,
    "settle_delay": 2e-5,
    "convert_period": 1e-6,
    "units": "V",
    "notes": "",
}


def electrode_xy() -> np.ndarray:
    return 0.01 + 0.02 * np.indices((8, 8)).reshape(2, -1).T


def noise(rng: np.random.Generator, scans: int, slots: int = 2) -> np.ndarray:
    """Codes of a rig that nothing touches."""
    return np.round(rng.normal(0, 2, (scans, slots, 64))).astype(np.int16)


def write(path, v: np.ndarray, grounds=None, /, *, leave_out=(), **changed):
    """A recording of the codes `v` (n, S, M); `changed` datasets or attributes."""
    scans, slots = v.shape[:2]
    grounds = np.array([0, 63])[:slots] if grounds is None else grounds
    datasets = {
        "v": v,
        "ground": np.broadcast_to(np.asarray(grounds, np.uint8), (scans, slots)),
        "t0": np.arange(scans) * slots / 10e3,
        "gaps": np.zeros((0, 2), np.int64),
        "electrode_xy": electrode_xy(),
    }
    attributes = dict(ATTRIBUTES)
    for name, value in changed.items():
        (datasets if name in datasets else attributes)[name] = value
    with h5py.File(path, "w") as file:
        for name, value in datasets.items():
            if name not in leave_out:
                file[name] = value
        for name, value in attributes.items():
            if name not in leave_out:
                file.attrs[name] = value
    return path


def write_matlab(path, v: np.ndarray, grounds):
    """The same as MATLAB's `save -v7.3` leaves it: variables, axes in reverse order."""
    scans, slots = v.shape[:2]
    arrays = {
        "v": v,
        "ground": np.broadcast_to(np.asarray(grounds, np.uint8), (scans, slots)),
        "t0": (np.arange(scans) * slots / 10e3)[:, None],
        "electrode_xy": electrode_xy(),
    }
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in arrays.items():
            data = file.create_dataset(name, data=value.T)
            data.attrs["MATLAB_class"] = np.bytes_(value.dtype.name)
        for name, value in ATTRIBUTES.items():
            if isinstance(value, str):
                codes = np.array([ord(c) for c in value] or [0], np.uint16)[:, None]
                data, kind = file.create_dataset(name, data=codes), "char"
            else:
                data = file.create_dataset(name, data=np.atleast_2d(value).T.astype(float))
                kind = "double"
            data.attrs["MATLAB_class"] = np.bytes_(kind)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return path


def touched(
    codes_scale: float = 5 / 32768, scans: int = 12, grounds=(0, 63), seed: int = 0
):
    """Codes of two corner slots with a contact in the middle third, and its place."""
    import tomojax as tx

    sensor = tx.Sensor.grid(divisions=(40, 40))
    place = np.array([0.094, 0.067])
    volts = np.asarray(tx.voltages(sensor, tx.Disc(place, 0.006, 1.0), list(grounds)))
    rng = np.random.default_rng(seed)
    codes = noise(rng, scans, len(grounds)).astype(int)
    codes[scans // 3 : 2 * scans // 3] += np.round(volts / codes_scale).astype(int)
    return codes.astype(np.int16), place


def volts(v: np.ndarray) -> np.ndarray:
    """Of codes, as readers make them."""
    return (v * ATTRIBUTES["scale"]).astype(np.float32)


def slot_times(v: np.ndarray) -> np.ndarray:
    scans, slots = v.shape[:2]
    t0 = np.arange(scans) * slots / 10e3
    return (t0[:, None] + np.arange(slots) / 10e3).ravel()


SIDECAR = """f_switch = 10e3
drive_voltage = 4.5
ground_resistance = 4.0
sheet_resistance = 10e3
electrode_diameter = 0.005
rows = 8
columns = 8
pitch = 0.02
"""


def write_csv(path, v: np.ndarray, grounds, separator: str = ",", decimal: str = "."):
    """In volts, with a description beside."""
    scans, slots, m = v.shape
    names = ["t", "ground", *(f"v{e}" for e in range(m))]
    lines = [separator.join(names)]
    rows = zip(slot_times(v), np.tile(grounds, scans), volts(v).reshape(-1, m).tolist())
    for t, ground, row in rows:
        cells = [repr(float(t)), str(ground), *(f"{x:.9g}" for x in row)]
        lines.append(separator.join(cells).replace(".", decimal))
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".toml").write_text(f"{SIDECAR}slots = {slots}\n")
    return path


def write_npz(path, v: np.ndarray, grounds):
    """Codes, with all that a recording says beside."""
    told = {n: a for n, a in ATTRIBUTES.items() if not isinstance(a, str)}
    t0 = slot_times(v).reshape(v.shape[:2])[:, 0]
    np.savez(path, v=v, ground=grounds, t0=t0, electrode_xy=electrode_xy(), **told)
    return path


def write_mcap(path, v: np.ndarray, grounds, lost=()):
    """A message for each slot that is not lost; what the rig is as metadata."""
    import json

    from mcap_ros2.writer import Writer

    text = """std_msgs/Header header
float64 device_time
uint64 number
uint32 ground
float32[] volts
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
    scans, slots, m = v.shape
    told = {n: a for n, a in ATTRIBUTES.items() if n not in ("scale", "offset")}
    told |= {"electrode_xy": electrode_xy().tolist(), "slots": slots}
    with path.open("wb") as file:
        writer = Writer(file)
        writer.add_metadata("tomojax", {n: json.dumps(a) for n, a in told.items()})
        schema = writer.register_msgdef("tomojax_msgs/msg/Slot", text)
        every = zip(slot_times(v), np.tile(grounds, scans), volts(v).reshape(-1, m))
        for number, (t, ground, row) in enumerate(every):
            if number in lost:
                continue
            stamp = dict(zip(("sec", "nanosec"), divmod(round(t * 1e9), 10**9)))
            message = {
                "header": {"stamp": stamp, "frame_id": "sheet"},
                "device_time": float(t),
                "number": number,
                "ground": int(ground),
                "volts": row.tolist(),
            }
            writer.write_message("/slots", schema, message, round(t * 1e9))
        writer.finish()
    return path


def write_tdms(path, v: np.ndarray, grounds, names: str = "ai{}"):
    from nptdms import ChannelObject, RootObject, TdmsWriter

    scans, slots, m = v.shape
    told = {n: a for n, a in ATTRIBUTES.items() if isinstance(a, float)}
    root = RootObject(properties={"slots_per_scan": slots, **told})
    columns = volts(v).reshape(-1, m).T
    channels = [ChannelObject("scan", names.format(e), columns[e]) for e in range(m)]
    ground = ChannelObject("scan", "ground", np.tile(grounds, scans).astype(np.int32))
    with TdmsWriter(path) as writer:
        writer.write_segment([root, *channels, ground])
    return path
