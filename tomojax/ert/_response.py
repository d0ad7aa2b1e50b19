"""Stands in for the learned response: the nearest frame that was seen, or column."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from tomojax._require import require
from tomojax._whole import whole
from tomojax.ert._recording import PairRecording
from tomojax.files import open_container
from tomojax.kernels.flags import Flag

SCHEMA = "tomojax-response"


class Located(NamedTuple):
    """Places of n frames, m, as the recording has them."""

    xy: Float[np.ndarray, "n 2"]
    covariance: Float[np.ndarray, "n 2 2"]
    strength: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, " n"]
    flags: Integer[np.ndarray, " n"]


class Response(NamedTuple):
    """Unit voltages and their places."""

    voltages: Float[np.ndarray, "k N"]
    xy: Float[np.ndarray, "k 2"]

    def save(self, path: Path | str) -> None:
        import h5py

        with whole(path) as part, h5py.File(part, "w") as file:
            file.attrs["schema"] = SCHEMA
            for name, values in self._asdict().items():
                file[name] = values

    @classmethod
    def load(cls, path: Path | str) -> "Response":
        with open_container(path) as file:
            schema = file.attributes.get("schema")
            require(schema == SCHEMA, f"{path}: schema", repr(schema), repr(SCHEMA))
            return cls(file.read_whole("voltages"), file.read_whole("xy"))

    def locate(self, voltages: Float[np.ndarray, "n C R"]) -> Located:
        flat = np.nan_to_num(voltages).reshape(len(voltages), -1)
        size = np.linalg.norm(flat, axis=1)
        alike = flat / np.maximum(size, 1e-30)[:, None] @ self.voltages.T
        best = alike.argmax(1)
        flags = np.where(size > 0, 0, Flag.NO_CONTACT.value).astype(np.uint32)
        covariance = np.broadcast_to(1e-5 * np.eye(2), (len(flat), 2, 2))
        left = np.sqrt(np.maximum(1 - alike.max(1) ** 2, 0))
        return Located(self.xy[best], covariance, size, left, flags)


def learn(
    recording: PairRecording,
    *,
    known: np.ndarray | None = None,
    frames: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Response:
    where = recording.places if known is None else known
    if where is None or not np.isfinite(where).all(1).any():
        return nominal(recording)
    some = np.flatnonzero(np.isfinite(where).all(1))[:frames]
    return _of(recording.voltages[some], where[some])


def nominal(recording: PairRecording) -> Response:
    from tomojax.ert._sheet_change import background, sensitivities

    sensor = recording.sensor()
    points = np.stack(
        np.meshgrid(*(np.linspace(0, s, 17)[1:-1] for s in recording.box)), -1
    )
    points = points.reshape(-1, 2)
    points = points[np.asarray(sensor.on_sheet(points))]
    columns = np.array(sensitivities(sensor, recording.pairs, points))
    if recording.magnitude:
        columns *= np.sign(np.asarray(background(sensor, recording.pairs)))
    return _of(-columns, points + recording.origin)


def _of(voltages: np.ndarray, xy: np.ndarray) -> Response:
    flat = np.nan_to_num(voltages).reshape(len(voltages), -1)
    size = np.linalg.norm(flat, axis=1, keepdims=True)
    return Response(flat / np.maximum(size, 1e-30), xy)
