"""The step of a robot: one slot in, contacts and the next ground out, compiled once."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from tomojax._require import require
from tomojax._shown import named
from tomojax.step._packing import Packed, packed, Packing, State
from tomojax.step._saving import load_state, save_state
from tomojax.step._state import About, Output, silent
from tomojax.step._traced import Traced
from tomojax.step.c import AbstractRuns, InC, write_folder


class Step:
    """A method and a policy as one compiled function of a state and a slot.

    `state` is the first state: two arrays, which `save` and `load` keep in a file.
    `step(state, voltages, ground)` gives the state after that slot and an `Output` in
    NumPy's arrays. The input is converted and checked for its shape. Nothing else in the
    input can raise or compile anew: flags tell of wrong input. `replay` runs recorded slots
    in one compiled loop. `image(state)` gives the image after a slot, on request.
    `make_step` makes a step.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> volts = tx.voltages(sensor, touch, [0, 15])
    >>> step = tx.make_step(sensor, "source", ["boundary", "all"], contacts=1, grid=8)
    >>> state = step.switch(step.state, "all")
    >>> state, out = step(state, volts[0], 0)
    >>> step.policies, step.image(state).shape
    (('boundary', 'all'), (8, 8))
    >>> step.save("state.npz", state)
    >>> state, out = step(step.load("state.npz"), volts[1], 15)  # goes on
    """

    def __init__(
        self,
        about: About,
        runs: AbstractRuns,
        again: Callable[[], "Step"],
        trace: Callable[[], Traced],
    ):
        self.about, self._runs, self._again, self._trace = about, runs, again, trace
        self.electrode_count = about.electrode_count
        self.condition_count = about.condition_count
        self.contact_count = about.contact_count
        self.policies, self.dtype = about.policies, np.dtype(about.dtype)
        example = jax.eval_shape(lambda: silent(about.contact_count, self.dtype))
        self._said = Packing(example, self.dtype)
        self.state = runs.first

    @property
    def native(self) -> bool:
        """Whether compiled C runs the slots; else a program of JAX does."""
        return self._runs.native

    @property
    def in_c(self) -> InC | None:
        """The compiled function's address and tables, for a loop in C; None for JAX."""
        return self._runs.in_c

    @property
    def traces(self) -> int:
        """How often the step was traced: never where it was kept."""
        return self._runs.traces

    def __reduce__(self) -> tuple[Any, ...]:
        """Lets pickle make the step anew where it goes: programs belong to a process."""
        return _made_again, (self._again,)

    def __repr__(self) -> str:
        about = self.about
        return named(
            self,
            method=about.method,
            policies=repr(self.policies),
            electrodes=str(self.electrode_count),
            contacts_at_most=str(self.contact_count),
            dtype=str(self.dtype),
            runs_as="C" if self.native else "JAX",
        )

    def __call__(
        self,
        state: State,
        voltages: Any,
        ground: Any,
        lost: int | np.integer = 0,
        hurried: bool = False,
    ) -> tuple[Packed, Output]:
        """Returns the state after a slot, and the slot's results."""
        v = np.asarray(voltages, self.dtype)
        if v.shape != (self.electrode_count,):
            expected = f"shape ({self.electrode_count},)"
            require(False, "voltages", f"shape {v.shape}", expected)
        slot = np.array((ground, lost, hurried), np.int32)
        after, said = self._runs.slot(packed(state), v, slot)
        return after, self._said.unpack(said)

    def replay(
        self, state: State, voltages: Any, grounds: Any, lost: Any = None
    ) -> tuple[Packed, Output]:
        """Runs a step for each row of `voltages` (n, M); outputs have n rows."""
        v = np.asarray(voltages, self.dtype)
        fits = v.ndim == 2 and v.shape[1] == self.electrode_count
        require(fits, "voltages", f"shape {v.shape}", f"(n, {self.electrode_count})")
        g = np.asarray(grounds)
        require(g.shape == (len(v),), "grounds", f"shape {g.shape}", f"({len(v)},)")
        gone = np.zeros(len(v), np.int32) if lost is None else np.asarray(lost, np.int32)
        require(gone.shape == g.shape, "lost", f"shape {gone.shape}", f"{g.shape}")
        slots = np.stack([g.astype(np.int32), gone, np.zeros_like(gone)], 1)
        after, said = self._runs.slots(packed(state), v, slots)
        return after, self._said.unpack(said)

    def image(self, state: State) -> Float[Array, "nx ny"] | Float[np.ndarray, "nx ny"]:
        """Returns the last slot's image, in the method's unit; NaN for an unusable slot."""
        return self._runs.image(packed(state))

    def save(self, path: Path | str, state: State) -> None:
        """Writes a state to an .npz file; the file is there whole or not at all."""
        save_state(path, packed(state), self.policies)

    def load(self, path: Path | str) -> Packed:
        """Reads a state that a step like this has saved.

        **Raises:** `ValueError` for a file that is none, or of another step.
        """
        return load_state(path, self.state, self.policies)

    def switch(self, state: State, policy: str) -> Packed:
        """Returns the state with another of the step's policies, from the next slot on."""
        names = ", ".join(self.policies)
        require(policy in self.policies, "policy", repr(policy), f"one of {names}")
        numbers, whole = packed(state)
        whole = np.array(whole)
        whole[self.about.policy_at] = self.policies.index(policy)
        whole[self.about.length_at] = 0
        return self._runs.given(Packed(np.asarray(numbers), whole))


def compile(  # noqa: A001
    step: Step,
    folder: Path | str,
    *,
    march: str = "native",
    libraries: bool = True,
    halved: bool = False,
) -> str:
    """Writes a step as a folder of C99: for programs and boards without Python.

    The folder gets `step.c` and `tomojax_step.h`: code, which serves every rig of the same
    shape; `step.tables`: the numbers of this one; `libtomojax_step.so` and `.a`, made by
    the compiler that is there (CC, cc, gcc or clang) for the processor `march`;
    `example.c`, which reads slots from standard input; `tomojax_step.hpp` for C++17;
    `CMakeLists.txt` and `tomojax_step.pc`; and `vectors.bin`, 10 000 slots with what JAX
    says of each, which `check.c` runs. Without `libraries` no compiler is needed. `halved`
    tables have 16 bits a number where they are largest: places move by a micrometre in the
    median, but by a quarter of a millimetre in one slot of a hundred, and one of 500 slots
    tells another number of contacts.

    Returns the name of the code, which its tables have to have.

    **Raises:** `ValueError` for a folder that holds other files, for a step with an
    operation that has no C, and where no compiler is there or it fails.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> step = tx.make_step(sensor, "source", ["all"], contacts=1, grid=8)
    >>> name = tx.step.compile(step, "step", libraries=False)
    >>> from pathlib import Path
    >>> sorted(path.name for path in Path("step").glob("*.h*"))
    ['tomojax_step.h', 'tomojax_step.hpp']
    """
    return write_folder(step._trace(), Path(folder), march, libraries, halved).name


def _made_again(again: Callable[[], Step]) -> Step:
    return again()
