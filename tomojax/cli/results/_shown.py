"""Answers the page of `tomojax view`: a row of results, and the time line around it."""

import json
import math
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.cli.results._timeline import Timeline
from tomojax.hardware import web
from tomojax.recordings import open_recording, Recording
from tomojax.results.loading import LoadedResults

_MOST = 1000  # parts of a time line
_MOST_FLAGS = 400  # parts of it that flags are drawn at
_TRAIL = 2000  # rows
_SPECTRUM = 2048  # scans


class ShownResults:
    """Answers the page's questions about the results in a file.

    `recording` is the path of the results' recording, or None without it. If `required`, a
    recording that cannot be opened is an error.
    """

    def __init__(
        self,
        path: Path,
        since: float | None,
        until: float | None,
        recording: Path | None,
        required: bool = False,
    ):
        self._line = Timeline(path, since, until)
        self._file = LoadedResults(path)
        self.marks = _marks(self._file.attributes.get("marks"))
        self._recording, self._heard = None, "recording: none at hand; --recording REC"
        if recording is not None and required:
            self._use(open_recording(recording))
        elif recording is not None:
            self._heard = f"{recording.name}: is being opened"
            # An hour's times take a while to be read.
            Thread(target=self._open, args=(recording,), daemon=True).start()
        self._last: Any = None

    def _open(self, path: Path) -> None:
        try:
            self._use(open_recording(path))
        except ValueError as error:
            self._heard = str(error)

    def _use(self, recording: Recording) -> None:
        count = len(self._file.electrode_xy())
        found = f"{recording.electrodes} electrodes"
        require(recording.electrodes == count, f"{recording.path}", found, f"{count}")
        self._heard, self._recording = recording.path.name, recording

    def document(self) -> dict[str, Any]:
        """Returns the page, before any data."""
        file = self._file
        xy = file.electrode_xy()
        shape, label = None, ""
        if "image" in file.names:
            shape = file.stretch("image", 0, 1).shape[1:]
            label = f"image, {file.unit('image')}"
        made = web.document(
            file.box(), xy, shape, label, self._line.span,
            self._line.words, file.outline(),
        )  # fmt: skip
        return made | {
            "live": False,
            "marks": False,
            "electrodes": len(xy),
            "residuals": "residual_by_electrode" in file.names,
            "span": list(self._line.span),
        }

    def answer(self, asked: dict[str, str]) -> dict[str, Any]:
        """Returns the row at the time `t`, and the time line from `from` to `to`."""
        file, line = self._file, self._line
        begin, end = line.span
        row = line.strongest
        if "t" in asked:
            row = line.row(file, _time(asked["t"], begin, end))
        since = _time(asked.get("from"), begin, end, begin)
        until = _time(asked.get("to"), begin, end, end)
        until = until if until > since else end
        sources, told, t = self._row(row)
        heard, volts = self._volts(row, t, asked)
        told.append(("voltages", heard))
        lines, names = self._time_line(since, until)
        sources |= volts | lines
        read = f"{100 * line.read:.0f} % of the rows are in the line"
        if line.failed:
            read += f"; then: {line.failed}"
        return {
            "sources": sources,
            "told": told,
            "flags": web.flag_lines(int(file.stretch("flags", row, row + 1)[0])),
            "names": names,
            "title": f"{file.path.name}, {file.rows} rows",
            "thinned": "" if line.read == 1 else read,
            "t": t,
        }

    def _row(self, row: int) -> tuple[dict[str, Any], list[tuple[str, str]], float]:
        file, names = self._file, self._file.names
        one = {n: file.stretch(n, row, row + 1)[0] for n in names if n in _OF_A_ROW}
        count, t = int(one["contact_count"]), float(file.stretch("t", row, row + 1)[0])
        xy = one["contact_xy"][:count]
        forces = "contact_force" in one
        pressed = "contact_strength" in one and not forces
        g = one["contact_strength" if pressed else "contact_conductance"][:count]
        unit = (1.0, "") if pressed else (1e6, " µS")
        tracks = one.get("contact_track")
        called = None if tracks is None else tracks[:count]
        sources: dict[str, Any] = {"contacts": web.contact_columns(xy, g, called, unit)}
        if "contact_covariance" in one:
            spread = one["contact_covariance"][:count]
            sources["ellipses"] = web.ellipse_columns(xy, spread)
        first = max(self._line.first, row - _TRAIL)
        step = max(1, (row + 1 - first) // 100)
        trail = file.stretch("contact_xy", first, row + 1)[::step]
        ages = np.repeat(np.linspace(0.05, 0.6, len(trail)), trail.shape[1])
        places = 1e3 * trail.reshape(-1, 2).astype(float)
        known = np.isfinite(places).all(1)
        x, y = places[known].T.tolist()
        sources["trails"] = {"x": x, "y": y, "age": ages[known].tolist()}
        if "image" in names:
            found = web.pixels(one["image"])
            high = found["high"] = found.pop("top")
            found["pixels"] = [v if v is None else v * high for v in found["pixels"]]
            sources["image"] = found
        if "residual_by_electrode" in names:
            each = web.numbers(1e3 * one["residual_by_electrode"].astype(float))
            sources["residuals"] = {"electrode": list(range(len(each))), "residual": each}
        sources["now"] = {"t": [t]}
        told = [
            ("time", f"{t:.6g} s, row {row}"),
            ("contacts", f"{count}"),
            ("method", str(file.attributes.get("method", "unknown"))),
        ]
        if "residual" in one and np.isfinite(one["residual"]):
            told.append(("residual", f"{1e3 * float(one['residual']):.3g} mV rms"))
        if forces:
            each = one["contact_force"][:count]
            told.append(("force", ", ".join(f"{f:.3g} N" for f in each) or "–"))
        return sources, told, t

    def _volts(self, row: int, t: float, asked: dict[str, str]) -> tuple[str, dict]:
        """Reads the row's voltages and a spectrum; says where from, or why not."""
        recording = self._recording
        if recording is None:
            return self._heard, {}
        slotwise = self._file.attributes.get("rate") == "slot"
        scan, slot = divmod(row, recording.slots) if slotwise else (row, 0)
        if scan >= recording.scans:
            return f"{self._heard} ends before this row", {}
        first = max(0, min(scan - _SPECTRUM // 2, recording.scans - _SPECTRUM))
        try:
            some = recording.read(first, min(first + _SPECTRUM, recording.scans))
        except ValueError as error:
            return str(error), {}
        if abs(float(some.t0[scan - first]) - t) > recording.interval:
            return f"{self._heard} is another recording: its times differ", {}
        electrode = web.chosen_electrode(asked, recording.electrodes)
        series = np.nan_to_num(some.voltages[:, slot, electrode].astype(float))
        found = {"volts": web.volt_columns(some.voltages[scan - first, slot])}
        if len(series) >= 16:
            found["spectrum"] = web.spectrum(series, 1 / recording.interval)
        return f"{self._heard}, ground {int(some.grounds[scan - first, slot])}", found

    def _time_line(self, since: float, until: float) -> tuple[dict[str, Any], list[str]]:
        line, scale = self._line, self._line.factor
        parts = line.parts(self._file, since, until, _MOST)
        t = parts.t.tolist()
        each = max(1, -(-len(t) // _MOST_FLAGS))
        at = np.arange(0, len(t), each)
        doubts = web.flag_rows(parts.t[at], np.bitwise_or.reduceat(parts.flags, at))
        marks = [one for one in self.marks if since <= one[0] <= until]
        line = {
            "t": t,
            "count": parts.contacts.tolist(),
            "low": web.numbers(scale * parts.low.astype(float)),
            "high": web.numbers(scale * parts.high.astype(float)),
        }
        return web.marked_line(line, doubts, marks, since, until)


_OF_A_ROW = (
    "contact_count", "contact_xy", "contact_conductance", "contact_covariance",
    "contact_strength", "contact_force", "contact_track", "residual",
    "residual_by_electrode", "image",
)  # fmt: skip


def _time(text: str | None, low: float, high: float, default: float = 0.0) -> float:
    """Returns a time that the page asks for, limited to the file's times."""
    try:
        number = default if text is None else float(text)
    except ValueError:
        number = default
    return min(max(number, low), high) if math.isfinite(number) else low


def _marks(told: Any) -> list[tuple[float, str]]:
    """Reads marks from a file's attribute; returns none from a broken attribute."""
    try:
        some = [(float(t), str(text)[:80]) for t, text in json.loads(told)]
    except (TypeError, ValueError, RecursionError):
        return []
    return [(t, text or "marked") for t, text in some if math.isfinite(t)][:1000]
