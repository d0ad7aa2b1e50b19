"""A virtual rig: a process that measures scenes made beforehand, at slot rate.

    python -m tomojax.hardware.sources.virtual SCENE.npz --link pty|udp [faults]

SCENE.npz has `voltages` (K, L, M) of K moments under each of L grounds, V. `dwell` is how
long each moment lasts, s. With a table of ground `conditions` (L, M), S, in SCENE.npz the
rig takes this table from the host, and no other. The rig speaks the protocol of
PROTOCOL.md on a pseudo-terminal or over UDP. It prints one line of JSON with its address.
Only the sheet is simulated: slots that cannot be sent in time are lost, and slot numbers go
on.
"""

import argparse
import ctypes
import json
import os
import signal
import socket
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from tomojax.files import read_npz
from tomojax.hardware.sources import _frames as frames

# Waits longer than this are slept, s; the rest is spun, as sleeping wakes late.
_SPIN = 3e-5


def wake_in_time() -> None:
    """Asks Linux to wake this process in time; others wake up to 50 µs late."""
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).prctl(29, 1, 0, 0, 0)  # PR_SET_TIMERSLACK, 1 ns


class Pty:
    """The rig's end of a pseudo-terminal; the other end has a name that stays."""

    def __init__(self, name: Path):
        if not hasattr(os, "openpty"):
            raise SystemExit("--link pty: this system has no pseudo-terminals; take udp")
        import tty

        from cobs import cobs

        from tomojax.hardware.sources.serial import Frames

        self._raw, self._cobs, self._frames = tty.setraw, cobs, Frames
        self.name, self._unsent = name, b""
        self.open()

    def open(self) -> None:
        self._master, self._slave = os.openpty()
        self._raw(self._slave)
        os.set_blocking(self._master, False)
        self._decode = self._frames(2048)
        self.name.unlink(missing_ok=True)
        self.name.symlink_to(os.ttyname(self._slave))

    @property
    def where(self) -> str:
        return f"serial:{self.name}"

    def commands(self) -> list[bytes]:
        try:
            return self._decode(os.read(self._master, 4096))
        except OSError:
            return []

    def send(self, message: bytes) -> bool:
        """Sends a message; returns whether there was room for it."""
        try:
            if self._unsent:
                self._unsent = self._unsent[os.write(self._master, self._unsent) :]
            if self._unsent:
                return False
            coded = self._cobs.encode(message) + b"\0"
            self._unsent = coded[os.write(self._master, coded) :]
        except OSError:
            return False
        return True

    def close(self) -> None:
        # A cut device has no name; the terminal's number may be another rig's next.
        self.name.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._slave)


class Udp:
    """The rig's socket; it answers the sender that asked the rig to start."""

    def __init__(self, port: int):
        self.port = port
        self.open()

    def open(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind(("127.0.0.1", self.port))
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]
        self._host: Any = None

    @property
    def where(self) -> str:
        return f"udp://127.0.0.1:{self.port}"

    def commands(self) -> list[bytes]:
        found = []
        try:
            while True:
                message, self._host = self._socket.recvfrom(2048)
                found.append(message)
        except OSError:
            return found

    def send(self, message: bytes) -> bool:
        try:
            return self._host is not None and bool(self._socket.sendto(message, self._host))
        except OSError:
            return False

    def close(self) -> None:
        self._socket.close()


class Firmware:
    """The rig's state and faults; `run` goes on until the time is up."""

    def __init__(self, link: Pty | Udp, options: argparse.Namespace):
        scene = read_npz(options.scene, "no scene", ("voltages", "dwell"), ("conditions",))
        self._link, self._options = link, options
        self._rng = np.random.default_rng(options.seed)
        full = 32000 / max(5.0, float(np.abs(scene["voltages"]).max()))
        self._scale = 1 / full
        self._codes = (scene["voltages"] * full).astype(np.float32)
        self._dwell = float(scene["dwell"])
        self.electrodes = self._codes.shape[-1]
        table = scene.get("conditions")
        given = [] if table is None else frames.rows_of(table, self.electrodes)
        self._rows = [frames.pack_row(row) for row in given]
        self._table: int | None = None
        self._held = 0
        size = (4096, self.electrodes)
        # Noise is drawn beforehand too: a slot has 100 µs.
        noise = self._rng.normal(0, options.noise * full, size)
        self._noise = noise.astype(np.float32)
        self._grounds: tuple[int, ...] = (0,)
        self._turn = self.sequence = 0
        self._running, self._late = False, b""
        self._switch_on()

    def _switch_on(self) -> None:
        self._session = int(self._rng.integers(1, 2**32))

    def run(self) -> None:
        o = self._options
        period, start = 1 / o.rate, time.perf_counter()
        due = start
        events = {"stall": o.stall, "disconnect": o.disconnect, "restart": o.restart}
        while (spent := time.perf_counter() - start) < o.seconds:
            for name, at in list(events.items()):
                if at is not None and spent >= at:
                    del events[name]
                    getattr(self, f"_{name}")()
            self._obey()
            due += period
            if o.jitter and self._rng.random() < 0.01:
                time.sleep(self._rng.uniform(0, o.jitter))
            left = due - time.perf_counter()
            if left < -0.01:  # it stalled: as much is lost
                gone = int(-left / period)
                self.sequence += gone
                due += gone * period
            if left > _SPIN:
                time.sleep(left - _SPIN)
            while time.perf_counter() < due:
                pass
            self._slot(due - start)

    def _obey(self) -> None:
        for message in self._link.commands():
            told = frames.unpack_command(message, self._codes.shape[1])
            kind, grounds = told or (None, ())
            if kind == frames.GROUNDS:
                self._grounds, self._turn = grounds, 0
            elif kind == frames.STOP:
                self._running = False
            elif kind == frames.START and not self._rows:
                self._describe()
            elif self._rows and (row := frames.unpack_row(message, self.electrodes)):
                if row.table != self._table:
                    self._table, self._held = row.table, 0
                self._held += message in self._rows[self._held : self._held + 1]
                self._describe()

    def _describe(self) -> None:
        o, m, session = self._options, self.electrodes, self._session
        numbers = self.sequence, o.rate, self._scale, 0.0, self._table, self._held
        self._link.send(frames.pack_description(frames.Description(m, session, *numbers)))
        self._running = self._held == len(self._rows)

    def _slot(self, when: float) -> None:
        o, rng, sequence = self._options, self._rng, self.sequence
        self.sequence += 1
        ground = self._grounds[self._turn % len(self._grounds)]
        self._turn += 1
        if not self._running:
            return
        if o.contrary and rng.random() < o.contrary:
            ground = int(rng.integers(self._codes.shape[1]))
        moment = int(when / self._dwell) % len(self._codes)
        codes = self._codes[moment, ground] + self._noise[sequence % 4096]
        if o.dead:
            codes[o.dead] = 32767
        clock = int(1e6 * when * (1 + 1e-6 * o.drift))
        message = frames.pack_slot(ground, sequence, clock, np.rint(codes))
        if o.loss and rng.random() < o.loss:
            return
        if o.corrupt and rng.random() < o.corrupt:
            broken = bytearray(message)
            for k in rng.integers(0, len(broken), 4):
                broken[k] ^= int(rng.integers(1, 256))
            message = bytes(broken)
        if o.reorder and rng.random() < o.reorder and not self._late:
            self._late = message
            return
        self._link.send(message)
        if self._late:
            self._link.send(self._late)
            self._late = b""

    def _stall(self) -> None:
        time.sleep(self._options.away)

    def _disconnect(self) -> None:
        self._link.close()
        time.sleep(self._options.away)
        self._link.open()
        self._running = False

    def _restart(self) -> None:
        self._disconnect()
        self.sequence = self._held = 0
        self._switch_on()


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("scene", type=Path)
    add("--link", choices=("pty", "udp"), default="pty")
    add("--name", type=Path, help="Path of the pseudo-terminal's link.")
    add("--port", type=int, default=0, help="Port of UDP; 0 takes any.")
    add("--rate", type=float, default=10e3, help="Slots a second.")
    add("--seconds", type=float, default=float("inf"))
    add("--noise", type=float, default=3e-4, help="Noise of each voltage, V rms.")
    add("--seed", type=int, default=0)
    add("--loss", type=float, default=0.0, help="Part of the slots that are lost.")
    add("--corrupt", type=float, default=0.0, help="Part of the slots with broken bytes.")
    add("--reorder", type=float, default=0.0, help="Part of the slots sent one slot late.")
    add("--contrary", type=float, default=0.0, help="Part with a ground not asked for.")
    add("--jitter", type=float, default=0.0, help="Longest delay of one slot in 100, s.")
    add("--drift", type=float, default=0.0, help="Error of its clock, parts per million.")
    add("--dead", type=int, nargs="*", default=[], help="Channels at the rail.")
    add("--stall", type=float, help="Stand still at this time, s from the start.")
    add("--disconnect", type=float, help="Cut the link at this time, s from the start.")
    add("--restart", type=float, help="Switch off and on at this time, s from the start.")
    add("--away", type=float, default=0.5, help="Time that each of those three lasts, s.")
    add(
        "--attached", action="store_true", help="End with the process that started the rig."
    )
    return parser


def _end_with_input() -> None:
    """Ends the process when no other process holds its input's other end any more."""
    while os.read(0, 1024):
        pass
    os.kill(os.getpid(), signal.SIGINT)


def main() -> None:
    chosen = options().parse_args()
    if chosen.link == "pty":
        name = chosen.name or chosen.scene.with_suffix(".tty")
        link: Pty | Udp = Pty(name)
    else:
        link = Udp(chosen.port)
    rig = Firmware(link, chosen)
    # A job in a shell's background ignores Ctrl-C, and so would all that it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if chosen.attached:
        threading.Thread(target=_end_with_input, daemon=True).start()
    try:
        print(json.dumps({"where": link.where, "electrodes": rig.electrodes}), flush=True)
        wake_in_time()
        rig.run()
    except KeyboardInterrupt:
        pass
    finally:
        # Its input may end while the process does: that is no news any more.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        link.close()
        if isinstance(link, Pty):
            link.name.unlink(missing_ok=True)
        try:
            print(json.dumps({"slots": rig.sequence}), flush=True)
        except BrokenPipeError:  # who started it has ended; Python would write once more
            os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
