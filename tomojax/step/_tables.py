"""Writes and reads tables of ground conditions by place."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from tomojax._require import require
from tomojax._whole import whole
from tomojax.files import read_npz
from tomojax.sensor import Sensor
from tomojax.step._policies import Lookup


def save_policy(policy: Lookup, path: Path | str) -> None:
    """Writes a table as an .npz file: `table`, `idle`, `size` (m), and `lam` if any.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> left_and_right = jnp.array([[[0, 3]], [[12, 15]]])  # grounds of 2 × 1 places
    >>> policy = tx.step.Lookup(left_and_right, jnp.array([0, 15]), sensor.size)
    >>> tx.step.save_policy(policy, "table.npz")
    >>> tx.step.load_policy("table.npz", sensor).table.shape
    (2, 1, 2)
    """
    arrays = {name: getattr(policy, name) for name in ("table", "idle", "size", "lam")}
    with whole(path) as part, part.open("wb") as file:
        given = {k: np.asarray(v) for k, v in arrays.items() if v is not None}
        np.savez(file, **given)  # pyright: ignore


def load_policy(path: Path | str, sensor: Sensor) -> Lookup:
    """Reads a file that `save_policy` has written, for that `sensor`.

    **Raises:** `ValueError` for a file that holds no table, or a table of another sensor.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> left_and_right = jnp.array([[[0, 3]], [[12, 15]]])  # grounds of 2 × 1 places
    >>> policy = tx.step.Lookup(left_and_right, jnp.array([0, 15]), sensor.size)
    >>> tx.step.save_policy(policy, "table.npz")
    >>> print(tx.step.load_policy("table.npz", sensor).idle)
    [ 0 15]
    >>> tx.step.load_policy("table.npz", tx.Sensor.grid())
    Traceback (most recent call last):
        ...
    ValueError: table.npz: size: got [0.08 0.08], expected [0.16 0.16]
    """
    file = read_npz(path, "no table of grounds", ("table", "idle", "size"), ("lam",))
    table, idle, size, lam = (file.get(n) for n in ("table", "idle", "size", "lam"))
    assert table is not None and idle is not None and size is not None
    whole = table.dtype.kind in "iu" and idle.dtype.kind in "iu"
    require(whole, f"{path}: table", table.dtype, "numbers of electrodes")
    fits = table.ndim == 3 and idle.shape == table.shape[2:] and table.size > 0
    require(fits, f"{path}: table", f"shape {table.shape}", "(nx, ny, slots)")
    m = sensor.condition_count
    known = 0 <= min(table.min(), idle.min()) and max(table.max(), idle.max()) < m
    require(known, f"{path}: table", f"{table.min()} to {table.max()}", f"0 to {m - 1}")
    same = size.shape == (2,) and np.allclose(size, np.asarray(sensor.size), rtol=1e-4)
    require(same, f"{path}: size", size, f"{np.asarray(sensor.size)}")
    fine = lam is None or (
        lam.shape == table.shape[:2] and bool((np.isfinite(lam) & (lam > 0)).all())
    )
    require(fine, f"{path}: lam", "no λ for each place", "numbers above 0")
    at = jnp.asarray(table, jnp.int32), jnp.asarray(idle, jnp.int32)
    given = None if lam is None else jnp.asarray(lam, sensor.dtype)
    return Lookup(*at, sensor.size, given)
