"""Makes steps from a sensor, a method and policies by their names."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool

from tomojax._require import one_of, require, require_kind, require_whole
from tomojax.methods import method as make_method, METHODS, Points
from tomojax.sensor import Calibration, Sensor
from tomojax.step._methods import AbstractStepMethod, EachSlot, Follow
from tomojax.step._policies import AbstractPolicy, policy as make_policy, policy_names
from tomojax.step._step import Step
from tomojax.step._traced import Traced
from tomojax.step.c import compiled, folder_of, JaxRuns, kept, wanted


def make_step(
    sensor: Sensor,
    method: str = "follow",
    policy: str | Sequence[Any] | np.ndarray | Array = "around_contacts",
    *,
    contacts: int = 2,
    f_switch: float = 10e3,
    grid: int | None = None,
    lam: float | None = None,
    cheaper: str | None = None,
    calibration: Calibration | None = None,
    good: Any = None,
    highest: float | None = None,
    tables: dict[str, AbstractPolicy] | None = None,
    native: bool | None = None,
) -> Step:
    """Makes a compiled step: from one slot after another to contacts and the next ground.

    **Arguments:** `method` is "follow" or one of `tomojax.method`. "follow" carries a few
    contacts on from slot to slot; other methods see each slot alone. `policy` is a name, or
    several to `switch` between. The patterns "around", "cop_line" and "point" begin with
    two corner slots each. "around_contacts" is *Around* by the contacts' places.
    "information" grounds the slot that is expected to say most of the places. Electrodes in
    order, [0, 7, 14], are a policy of the name "0,7,14". `tables` holds your own policies
    by name, such as a `Lookup`. `contacts` is the highest number of contacts. `f_switch`,
    the rig's rate (slots/s), limits how far a contact moves in one slot. `lam` is λ (by
    default the method's own without a recording). `cheaper` names a method that answers
    slots that are `hurried`. `calibration` is the rig's: its zeros and gains are taken off
    the readings. `good` (M,) marks the channels that are used. `highest` is |V| that no
    channel can have, V.

    A step runs as C that a compiler makes of it, in a fifth to a tenth of the time of JAX's
    program: where a C compiler is there, on a processor. A step that is too large, or has
    an operation without C, stays JAX's: `auto` and `shape`. C is kept in the user's cache
    folder: the same step is there at once the next time.
    `native` decides it: False for JAX's program,
    True for C. The variable TOMOJAX_NATIVE=0 stands for False where nobody decides;
    TOMOJAX_STEPS names the folder, and with nothing in it nothing is kept.

    **Raises:** `ValueError` for unknown names, `contacts` outside 1 to 8, arrays of wrong
    shape, and `native` where no compiler is there or it fails.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> volts = tx.voltages(sensor, touch, [0, 15])
    >>> step = tx.make_step(sensor, "source", ["boundary", "all"], contacts=1, grid=8)
    >>> state, out = step(step.state, volts[0], 0)  # electrode 0 was grounded
    >>> int(out.contacts.count), int(out.ground)  # the next to be grounded
    (1, 15)
    >>> tx.make_step(sensor, "source", ["all", [0, 3, 15]], contacts=1, grid=8).policies
    ('all', '0,3,15')
    """
    check_followed(contacts)
    m = sensor.electrode_count
    used = np.ones(m, bool) if good is None else np.asarray(good, bool)
    require(used.shape == (m,), "good", f"shape {used.shape}", f"shape ({m},)")
    require(used.sum() >= 4, "good", f"{used.sum()} channels", "4 or more")
    rate = np.isfinite(f_switch) and f_switch > 0
    require(rate, "f_switch", f_switch, "slots/s, above 0")
    names = policy_names(policy)
    require(names, "policy", names, "at least one")
    if calibration is not None:
        require_kind("calibration", calibration, Calibration)
    for name in [method] + ([] if cheaper is None else [cheaper]):
        known = "follow", *METHODS  # some may be a user's own
        require(name in known, "method", repr(name), one_of(name, known))
    drive = abs(float(sensor.drive_voltage))
    limit = 1.05 * drive if highest is None else float(highest)
    require(limit > 0, "highest", limit, "volts above 0")
    asked = Asked(
        sensor, method, tuple(names), contacts, float(f_switch), grid, lam, cheaper,
        calibration, used, limit, tables or {},
    )  # fmt: skip
    again = partial(_made, asked, native)
    return again()


class Asked(NamedTuple):
    """What a step is made of, checked."""

    sensor: Sensor
    method: str
    names: tuple[str, ...]
    contacts: int
    f_switch: float
    grid: int | None
    lam: float | None
    cheaper: str | None
    calibration: Calibration | None
    used: Bool[np.ndarray, " M"]
    highest: float
    tables: dict[str, AbstractPolicy]


def _made(asked: Asked, native: bool | None) -> Step:
    """Reads a step that was kept, or makes one; C where it is wanted and can be had."""
    again, trace = partial(_made, asked, native), partial(_traced, asked)
    if not (wanted() if native is None else native):
        return _of_jax(trace(), again)
    # A method or a policy that is a user's own is code that no digest knows.
    kinds = [METHODS[n] for n in (asked.method, asked.cheaper) if n in METHODS]
    kinds += [type(policy) for policy in asked.tables.values()]
    ours = all(kind.__module__.startswith("tomojax.") for kind in kinds)
    folder = folder_of(asked) if ours else None
    found = kept(folder)
    if found is None:
        traced = trace()
        try:
            found = compiled(traced, folder)
        except ValueError:
            if native:
                raise
            return _of_jax(traced, again)
    return Step(*found, again, trace)


def _of_jax(traced: Traced, again: Callable[[], Step]) -> Step:
    return Step(traced.about, JaxRuns(traced), again, lambda: traced)


def _traced(asked: Asked) -> Traced:
    sensor, used = asked.sensor, asked.used
    calibration = asked.calibration

    def made(name: str) -> AbstractStepMethod:
        if name == "follow":
            points = make_method(sensor, "points", asked.grid, calibration)
            assert isinstance(points, Points)
            return Follow.of(points, asked.contacts, used, asked.f_switch)
        found = make_method(sensor, name, asked.grid, calibration)
        value = found.choose_lambda([]) if asked.lam is None else asked.lam
        return EachSlot.of(found, asked.contacts, used, value)

    main = made(asked.method)
    # Tables of what slots tell are of contacts that are followed.
    by_place = main if isinstance(main, Follow) else None
    if "information" in asked.names and by_place is None:
        by_place = made("follow")
    own = asked.tables
    policies = {
        name: own[name] if name in own else make_policy(sensor, name, by_place)
        for name in asked.names
    }
    quick = None if asked.cheaper is None else made(asked.cheaper)
    rig = Calibration() if calibration is None else calibration
    return Traced(sensor, main, quick, policies, used, asked.highest, rig)


def check_followed(contacts: int) -> None:
    """Checks how many contacts a step follows. **Raises:** `ValueError` but for 1 to 8."""
    require_whole("contacts", contacts, 1, 8)
