"""A step's state as a file, to go on with later."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from tomojax._require import require
from tomojax._whole import whole
from tomojax.files import read_npz
from tomojax.step._packing import Packed


def save_state(path: Path | str, state: Packed, policies: tuple[str, ...]) -> None:
    """Writes an .npz file: `numbers`, `whole`, and the policies' names as UTF-8."""
    names = np.frombuffer("\n".join(policies).encode(), np.uint8)
    arrays = {name: np.asarray(values) for name, values in state._asdict().items()}
    with whole(path) as part, part.open("wb") as file:
        np.savez(file, policies=names, **arrays)  # pyright: ignore


def load_state(path: Path | str, first: Packed, policies: tuple[str, ...]) -> Packed:
    """Reads a state of a step that begins with `first` and has these policies.

    **Raises:** `ValueError` for a file that is none, or of another step.
    """
    file = read_npz(path, "no state of a step", (*Packed._fields, "policies"))
    found = file["policies"].astype(np.uint8).tobytes().decode(errors="replace")
    expected = ", ".join(policies)
    same = found.split("\n") == list(policies)
    require(same, f"{path}: policies", ", ".join(found.split("\n")), expected)
    for name, mine in first._asdict().items():
        told = file[name]
        fits = told.shape == mine.shape and told.dtype == mine.dtype
        expected = f"{mine.dtype} {mine.shape}, as this step's state"
        require(fits, f"{path}: {name}", f"{told.dtype} {told.shape}", expected)
    return Packed(*(jnp.asarray(file[name]) for name in Packed._fields))
