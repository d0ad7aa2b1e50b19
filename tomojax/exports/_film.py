"""Draws a film of results: the sheet with contacts and their strength, in real time."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._pictures import lay_sheet, show_image, SKY
from tomojax._require import require
from tomojax._whole import whole
from tomojax.exports._overview import draw_overview, Overview, overview, rings
from tomojax.exports._source import Progress, Source
from tomojax.kernels.flags import Flag

_RATE = 50  # pictures a second by default
_GIF = 50  # pictures a second that a GIF can have at most

# Seconds of the past that a trail shows; of the film, so that slow ones have theirs.
_TRAIL = 0.3

# Pictures that the scale of the image's colours is taken from.
_SAMPLED = 200

_Put = Callable[[np.ndarray], Any]  # takes the pixels of the next picture


def write(
    source: Source,
    out: Path,
    progress: Progress,
    rate: int | None = None,
    slow: float | None = None,
) -> None:
    """Draws `rate` pictures a second; the film is `slow` times slower than real time.

    **Raises:** `ValueError` for an MP4 without ffmpeg, or a GIF of over 50 pictures a
    second.
    """
    rate, slow = rate or _RATE, slow or 1.0
    require(slow > 0, "slow", slow, "a number above 0")
    gif = out.suffix.lower() == ".gif"
    ffmpeg = shutil.which("ffmpeg")
    mend = "a .gif, or ffmpeg installed"
    require(gif or ffmpeg, f"{out}", "no ffmpeg on this machine", mend)
    fits = not gif or rate <= _GIF
    require(fits, "rate", rate, f"{_GIF} pictures a second at most in a GIF")
    t = source.times()
    length = float(t[-1] - t[0])
    due = t[0] + np.arange(int(length * rate * slow + 1e-6) + 1) / (rate * slow)
    rows = np.maximum(np.searchsorted(t, due + 1e-9, "right") - 1, 0)
    picture = _Picture(source, overview(source), rows, int(_TRAIL * rate))
    picture.pace = "" if slow == 1 else f"{slow:g} × slower"
    with whole(out) as part:
        keep = _gif if gif else _mp4
        with keep(part, rate, picture.shape) as put:
            for number, row in enumerate(rows.tolist()):
                put(picture.draw(number, row))
                progress(number + 1, len(rows))


@contextmanager
def _mp4(path: Path, rate: int, shape: tuple[int, int]) -> Iterator[_Put]:
    """Sends pictures to ffmpeg, which chooses its codec for MP4."""
    height, width = shape
    command = ["ffmpeg", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgba"]
    command += ["-s", f"{width}x{height}", "-r", str(rate), "-i", "-", "-an"]
    command += ["-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stderr=pipe) as process:
        to, back = process.stdin, process.stderr
        assert to is not None and back is not None
        try:
            yield lambda pixels: to.write(pixels.tobytes())
            to.close()
            said = back.read().decode(errors="replace")
        except BrokenPipeError:
            said = back.read().decode(errors="replace") or "it ended early"
        except BaseException:
            process.kill()
            raise
    if process.returncode or said:
        raise OSError(f"ffmpeg: {' '.join(said.split())[-200:]}")


@contextmanager
def _gif(path: Path, rate: int, shape: tuple[int, int]) -> Iterator[_Put]:
    """Writes pictures as a GIF; all pictures have the colours of the first."""
    from PIL import Image

    frames: list[Any] = []

    def put(pixels: np.ndarray) -> None:
        frame = Image.fromarray(pixels[..., :3])
        if frames:
            frame = frame.quantize(palette=frames[0], dither=Image.Dither.NONE)
        else:
            frame = frame.quantize(255)
        frames.append(frame)

    yield put
    first, *rest = frames
    first.save(path, save_all=True, append_images=rest, duration=round(1000 / rate), loop=0)


class _Picture:
    """A figure, drawn once; each picture draws only the moving parts."""

    def __init__(self, source: Source, whole: Overview, rows: np.ndarray, trail: int):
        from matplotlib.figure import Figure

        from tomojax.results.plots import still

        self._source, self._trail, self.pace = source, trail, ""
        names = ("t", "contact_count", "contact_xy", "contact_radius", "flags", "image")
        self._names = [name for name in names if name in source.names]
        self._past: list[np.ndarray] = []
        figure = Figure(figsize=(6.4, 7.2), dpi=100, layout="constrained")
        sheet, line = figure.subplots(2, 1, height_ratios=(4, 1))
        self._shown = None
        if "image" in source.names:
            some = rows[:: max(1, len(rows) // _SAMPLED)].tolist()
            tops = [float(np.nanmax(source.row("image", k), initial=0)) for k in some]
            top = float(np.percentile(tops, 95)) or 1.0
            bar = f"image, {source.unit('image').replace('^2', '²')}"
            first, most = source.row("image", int(rows[0])), {"vmin": 0, "vmax": top}
            self._shown = show_image(sheet, first, source.size, bar, "max", **most)
        else:
            sheet.set_facecolor("black")
        told = source.box, source.electrode_xy
        electrodes = lay_sheet(sheet, *told, outline=source.outline)
        (self._dots,) = sheet.plot([], [], ".", color=SKY, ms=2, alpha=0.6)
        (self._rings,) = sheet.plot([], [], color=SKY, lw=1.2)
        # The layout leaves room for a title that is there.
        self._title = sheet.set_title("0 s", fontsize=10, loc="left", family="monospace")
        draw_overview(line, whole)
        self._now = line.axvline(whole.t[0], color="k", lw=1)
        moving = self._shown, electrodes, self._dots, self._rings
        shown = [artist for artist in moving if artist is not None]
        self._pixels = still(
            figure, [*shown, *sheet.spines.values(), self._title, self._now]
        )
        self.shape = self._pixels().shape[:2]

    def draw(self, number: int, row: int) -> np.ndarray:
        """Draws a picture; returns the pixels (height, width, 4)."""
        source = self._source
        told = {name: source.row(name, row) for name in self._names}
        count = int(told["contact_count"])
        xy = 1e3 * told["contact_xy"][:count]
        radius = 1e3 * told.get("contact_radius", np.full(count, np.nan))[:count]
        self._past = [*self._past[-self._trail :], xy]
        if self._shown is not None:
            self._shown.set_data(told["image"].T)
        self._dots.set_data(*np.concatenate(self._past).T)
        self._rings.set_data(*rings(xy, radius).T)
        flags = Flag(int(told["flags"]))
        level = flags.level.name.lower().replace("_", " ") if flags.level else ""
        what = "no contact" if not count else f"{count} contact{'s'[: count > 1]}"
        self._title.set_text(f"{told['t']:8.3f} s  {self.pace}  {what}  {level}")
        self._now.set_xdata([told["t"]] * 2)
        return self._pixels()
