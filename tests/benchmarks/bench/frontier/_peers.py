"""Rows of the peers: code that a lab would write without this package, at its best.

The peers are those of `_peer_operators`. They get our methods' patterns, batches, pixels
and dtype. Three choices put single contacts nearest to their true places: λ, how a place is
read, and which points stand for a pixel. They are chosen in hindsight, which favours the
peers.
"""

import time
from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import product
from typing import Any, NamedTuple

import jax
import numpy as np

from bench.frontier._measure import grounds_of, Job, repeated, timing
from bench.frontier._peer_operators import (
    Images,
    Peer,
    peers_of,
    read_half,
    read_peak,
)
from bench.frontier._scenes import KINDS, score, Trials
from tomojax.kernels.images import Contacts, read_contacts
from tomojax.methods import Rows
from tomojax.sensor import Sensor

_READINGS = {"peak": read_peak, "half": read_half}
_OUTPUTS = ("contacts", "image")

# Contacts that are read off an image where no time is taken.
_CONTACTS = 3

# λ/σ₁² in half decades: the first range, its widening, how far it goes; and by how much an
# end has to be better than what lies inside.
_FIRST, _WIDER, _LIMITS, _BETTER = (-16, 2), 4, (-28, 14), 0.999


class Choice(NamedTuple):
    """The choice that is nearest for single contacts, all in hindsight."""

    error: float  # mm, in the median
    peer: Peer
    lam: float  # λ/σ₁²
    at_end: bool  # of the widest range of λ
    reading: str


def peer_rows(job: Job, sensor: Sensor, trials: Trials) -> Iterator[dict[str, Any]]:
    """Yields rows of each peer and pattern, as contacts and as images.

    For "contacts", vectorised NumPy reads one contact's place off the image, and the time
    includes reading. For "image", the image is the output. This package then reads up to
    three contacts off the image, outside the measured time.
    """
    size, pixels = np.asarray(sensor.size, float), job.pixels
    peers = list(peers_of(sensor, pixels))
    for name in job.patterns:
        grounds = grounds_of(sensor, name, trials.volts)
        volts = np.take_along_axis(trials.volts, grounds[..., None], 1)
        volts = volts.reshape(len(volts), -1).astype(job.dtype)
        for variants in peers:
            peer = variants[0]
            if peer.products == 2 and grounds.shape[1] == 1:
                continue  # one product is the smaller one
            if peer.name == "pyEIT" and (grounds != grounds[0]).any():
                continue  # up to seconds for each new ground set
            best = hindsight(variants, volts, grounds, trials, size)
            for output, chosen in best.items():
                made = peer_images(chosen.peer, volts, grounds, chosen.lam)
                rows = peer_contacts(output, chosen.reading, *made, size)
                scores = _scores(rows, trials, size)
                begin = time.perf_counter()
                solve = chosen.peer.prepare(grounds[0], chosen.lam, job.dtype)
                ready = 1e3 * (time.perf_counter() - begin)
                call = contact_of(solve, chosen.reading, pixels, size)
                call = solve if output == "image" else call
                for batch in job.batches:
                    frames = np.resize(volts, (batch, volts.shape[1]))
                    times = timing(*repeated(lambda c=call, f=frames: c(f)), batch)
                    for kind in KINDS:
                        yield {
                            "scene": kind,
                            "method": peer.name,
                            "peer": True,
                            "pattern": name,
                            "slots": grounds.shape[1],
                            "lam_rule": "best in hindsight",
                            "lam": chosen.lam,
                            "lam_at_end": chosen.at_end,
                            "reading": chosen.reading,
                            "products": peer.products,
                            "stands": chosen.peer.stands,
                            "pixels": pixels,
                            "elements": pixels**2,
                            "output": output,
                            "prepare_ms": ready,
                            **times,
                            **scores[kind],
                            "dtype": job.dtype,
                            "device": "cpu",
                        }


def contact_of(solve: Images, reading: str, pixels: int, size: np.ndarray) -> Images:
    """Returns a function from frames to places."""
    read = _READINGS[reading]
    return lambda frames: read(solve(frames), pixels, size)


def hindsight(
    variants: list[Peer],
    volts: np.ndarray,
    grounds: np.ndarray,
    trials: Trials,
    size: np.ndarray,
) -> dict[str, Choice]:
    """Finds for each output the choice with the least error of single contacts."""
    one = np.flatnonzero(trials.kind == "one")
    volts, grounds, trials = volts[one], grounds[one], trials.of(one)
    found: dict[str, list[Choice]] = {output: [] for output in _OUTPUTS}
    for peer in variants:
        made = cache(partial(peer_images, peer, volts, grounds))
        for output, reading in product(_OUTPUTS, _READINGS):

            def error(lam: float, made=made, output=output, reading=reading) -> float:
                images, currents = made(lam)
                rows = peer_contacts(output, reading, images, currents, size)
                value = score(rows, trials, size)["with_ghosts_median_mm"]
                return np.inf if value is None else value

            lam, at_end = best_lambda(error)
            found[output].append(Choice(error(lam), peer, lam, at_end, reading))
    return {out: min(some, key=lambda choice: choice.error) for out, some in found.items()}


def best_lambda(error: Callable[[float], float]) -> tuple[float, bool]:
    """Finds the λ of least error, and tells whether λ lies at the end of the widest range.

    The range widens while its end is better than all values inside.
    """
    low, high = _FIRST
    error = cache(error)
    while True:
        grid = [float(10.0 ** (k / 2)) for k in range(low, high + 1)]
        errors = [error(lam) for lam in grid]
        inner = 1 + int(np.argmin(errors[1:-1]))
        below, above = (bool(errors[k] < _BETTER * errors[inner]) for k in (0, -1))
        if below and low > _LIMITS[0]:
            low -= _WIDER
        elif above and high < _LIMITS[1]:
            high += _WIDER
        else:
            break
    at_end = below or above
    return grid[int(np.argmin(errors)) if at_end else inner], at_end


def peer_images(
    peer: Peer, volts: np.ndarray, grounds: np.ndarray, lam: float
) -> tuple[np.ndarray, np.ndarray]:
    """Returns images and currents of frames, each by its own ground set's operator."""
    images, currents = [], []
    sets, member = np.unique(grounds, axis=0, return_inverse=True)
    order = np.argsort(member, kind="stable")
    for k, own in enumerate(sets):
        solve = peer.prepare(own, lam, volts.dtype.name)
        images.append(solve(volts[member == k]))
        currents.append(peer.currents(images[-1], own))
    back = np.argsort(order)
    return np.concatenate(images)[back], np.concatenate(currents)[back]


def peer_contacts(
    output: str, reading: str, images: np.ndarray, currents: np.ndarray, size: np.ndarray
) -> Rows:
    """Returns contacts of images.

    For "contacts", an image has one contact, and only its place is known. Otherwise this
    package reads contacts: peaks as `source` does, halves as `linear` does.
    """
    n, pixels = len(images), int(np.sqrt(images.shape[1]))
    shaped = None
    if output == "contacts":
        places = _READINGS[reading](images, pixels, size)[:, None]
        nan = np.full((n, 1), np.nan)
        contacts: Any = (
            np.ones(n, np.uint8),
            places,
            *[nan] * 4,
            np.full((n, 1, 3), np.nan),
        )
        contacts = Contacts(*contacts)
    else:
        shaped = images.reshape(n, pixels, pixels)
        both = (a.reshape(shaped.shape).astype("f4") for a in (images, currents))
        contacts = _several(*both, np.asarray(size / pixels, "f4"), reading == "peak")
        contacts = jax.tree.map(np.asarray, contacts)
    return Rows.of(
        contacts,
        residual=np.zeros(n),
        flags=np.zeros(n, np.uint32),
        rung=np.zeros(n, np.uint8),
        image=shaped,
    )


@partial(jax.jit, static_argnames="peak")
def _several(
    images: jax.Array, currents: jax.Array, cell: jax.Array, peak: bool
) -> Contacts:
    """Reads up to three contacts of each image."""
    level = 0.8 if peak else 0.5

    def read(image: jax.Array, current: jax.Array) -> Contacts:
        return read_contacts(image, current, cell, _CONTACTS, level, peak)

    return jax.vmap(read)(images, currents)


def _scores(rows: Rows, trials: Trials, size: np.ndarray) -> dict[str, dict]:
    found = {}
    for kind in KINDS:
        at = np.flatnonzero(trials.kind == kind)
        found[kind] = score(rows.take(at), trials.of(at), size)
    return found
