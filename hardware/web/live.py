"""Serves the page of the live loop: a separate process that reads the ring."""

import json
import sys
import time
from collections import deque
from typing import Any

import numpy as np

from tomojax.hardware.loop import begun, counted_text, latency_text, load_text, SlotRing
from tomojax.hardware.web import _data as data
from tomojax.hardware.web._page import document, flag_rows
from tomojax.hardware.web._server import Pages, quiet, serve
from tomojax.recordings import rig_of

_SPAN = 30.0  # s of the time line
_PART = 0.1  # s of one of its parts
_SPECTRUM = 4096  # slots
_TRAIL = 40  # pictures
_NICE = 5  # it gives way to the loop


class LivePage:
    """Keeps the last seconds of a ring in few numbers, and answers the page with them.

    `look` is called about ten times a second, even if no page asks.
    """

    def __init__(self, ring: SlotRing, told: dict[str, Any], recorded: bool):
        self._ring, self._recorded, self._row = ring, recorded, int(ring.head["rows"])
        self._scale, self._offset = float(told["scale"]), float(told["offset"])
        self._rate = float(told["f_switch"])
        self._parts: deque[tuple] = deque(maxlen=int(_SPAN / _PART))
        self._trail: deque[tuple[float, float]] = deque(maxlen=_TRAIL)
        self._marks: deque[tuple[float, str]] = deque(maxlen=50)
        self._seen, self._slots = deque(maxlen=20), 0
        self._last: Any = None

    def mark(self, text: str) -> float:
        """Marks the newest slot's moment; returns the moment's time, s."""
        t = self._ring.mark(text)
        self._marks.append((t, text[:80] or "marked"))
        return t

    def look(self) -> None:
        """Takes in new slots as one part of the time line."""
        rows, self._row, gone = self._ring.since(self._row)
        self._slots += len(rows) + gone
        self._seen.append((time.monotonic(), self._slots))
        if not len(rows):
            return
        worked = rows[np.isfinite(rows["latency"])]
        shown = worked if len(worked) else rows
        self._last = shown[-1].copy()
        there = np.arange(self._ring.contacts) < shown["count"][:, None]
        total = np.where(there, shown["conductance"], 0).sum(1)
        flags = np.bitwise_or.reduce(rows["flags"])
        t, count = float(shown["time"][-1]), int(shown["count"].max())
        if self._parts and t < self._parts[-1][0]:  # the rig's clock begins anew
            self._parts.clear()
        self._parts.append((t, count, float(total.min()), float(total.max()), int(flags)))
        self._trail.extend(self._last["xy"][: self._last["count"]].tolist())

    def answer(self, asked: dict[str, str]) -> dict[str, Any]:
        """Returns the picture each time, and `lines` and spectra when asked."""
        ring, last = self._ring, self._last
        if last is None:
            told = [("state", "no slot yet"), *self._counted()]
            return {"sources": {}, "told": told, "flags": [], "title": "waiting for slots"}
        trail = np.array(list(self._trail)).reshape(-1, 2)
        ages = np.linspace(0.1, 0.8, len(trail)).tolist()
        count = int(last["count"])
        sources = {
            "image": data.pixels(ring.head["image"]),
            "contacts": data.contact_columns(
                last["xy"][:count], last["conductance"][:count]
            ),
            "trails": {
                "x": (1e3 * trail[:, 0]).tolist(),
                "y": (1e3 * trail[:, 1]).tolist(),
                "age": ages,
            },
        }
        said: dict[str, Any] = {
            "sources": sources,
            "told": [*self._said(last), *self._counted()],
            "flags": data.flag_lines(int(last["flags"])),
            "title": "live",
        }
        if "lines" in asked:
            self._add_lines(said, asked)
        return said

    def _said(self, last: Any) -> list[tuple[str, str]]:
        ring = self._ring
        newest = float(ring.rows["time"][(int(ring.head["rows"]) - 1) % ring.length])
        (since, first), (now, slots) = self._seen[0], self._seen[-1]
        rate = (slots - first) / max(now - since, 1e-9)
        age = 1e3 * (newest - float(last["time"]))
        delay = latency_text(ring, 0.5, 0.99, 0.999).partition(": ")[2]
        return [
            ("rig's clock", f"{float(last['time']):.3f} s, ground {int(last['ground'])}"),
            ("slots", f"{rate:.0f}/s"),
            ("last byte to ground command, 50, 99, 99.9 %", delay or "not worked on"),
            ("load", load_text(ring) or "not worked on"),
            ("picture's age", f"{age:.0f} ms behind the newest slot"),
        ]

    def _counted(self) -> list[tuple[str, str]]:
        ring = self._ring
        said = [("also", line) for line in ring.said().splitlines()]
        recorded = self._in_file() if self._recorded else "not recorded"
        return [("counted", counted_text(ring)), ("recorder", recorded), *said]

    def _in_file(self) -> str:
        """Says how much of the session the recorder has written."""
        names = "rows", "recorded", "dropped", "marks", "marked"
        rows, recorded, dropped, marks, marked = (int(self._ring.head[n]) for n in names)
        text = f"{recorded} slots, {rows - recorded} to come"
        text += f", {dropped} NOT" if dropped else ""
        text += f"; {marked} marks"
        return text + (f", {marks - marked} to come" if marks > marked else "")

    def _add_lines(self, said: dict[str, Any], asked: dict[str, str]) -> None:
        t, count, low, high, flags = (list(c) for c in zip(*self._parts))
        low, high = (data.numbers(1e6 * np.array(some)) for some in (low, high))
        line = {"t": t, "count": count, "low": low, "high": high}
        since = t[-1] - _SPAN
        marks = [(when, text) for when, text in self._marks if when >= since]
        shown, names = data.marked_line(line, flag_rows(t, flags), marks, since, t[-1])
        said |= {"names": names, "times": [since, t[-1]]}
        sources = said["sources"]
        volts = self._scale * self._last["codes"].astype(float) + self._offset
        sources |= {**shown, "volts": data.volt_columns(volts)}
        ring, end = self._ring, int(self._ring.head["rows"])
        first = max(0, end - _SPECTRUM)
        if end - first < 64:
            return
        codes = ring.rows["codes"][np.arange(first, end) % ring.length]
        electrode = data.chosen_electrode(asked, ring.electrodes)
        sources["spectrum"] = data.spectrum(
            self._scale * codes[:, electrode].astype(float), self._rate
        )


def main() -> None:
    given = begun(__doc__, "ring", "told", "--recorded", nice=_NICE)
    quiet()
    recorded = given.recorded is not None
    ring, told = SlotRing(given.ring, writable=recorded), json.loads(given.told)
    shape, edge = ring.head["image"].shape, rig_of(told).outline
    made = document(
        told["size"], told["electrode_xy"], shape, "image, shares of its highest",
        (-_SPAN, 0.0), "conductance, µS", edge and edge.lines(told["size"]),
    )  # fmt: skip
    made |= {
        "live": True, "marks": recorded, "electrodes": ring.electrodes,
        "residuals": False, "span": [0, 1],
    }  # fmt: skip
    page = LivePage(ring, told, recorded)
    pages = Pages(made, page.answer, page.mark if recorded else None)
    tell = lambda url: print(f"page: {url}", file=sys.stderr, flush=True)  # noqa: E731
    serve(pages, tell, until=lambda: ring.done, meanwhile=page.look)


if __name__ == "__main__":
    main()
