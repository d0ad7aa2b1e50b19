"""Makes steps from a sensor, a method and policies by their names."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Array

from tomojax._require import one_of, require, require_whole
from tomojax.methods import method as make_method, METHODS, Points
from tomojax.sensor import Calibration, Sensor
from tomojax.step._methods import AbstractStepMethod, EachSlot, Follow
from tomojax.step._policies import AbstractPolicy, policy as make_policy, policy_names
from tomojax.step._step import Step


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
    **Raises:** `ValueError` for unknown names, `contacts` outside 1 to 8, and arrays of
    wrong shape.

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
    own = tables or {}

    def made(name: str) -> AbstractStepMethod:
        names = "follow", *METHODS  # some may be a user's own
        require(name in names, "method", repr(name), one_of(name, names))
        if name == "follow":
            points = make_method(sensor, "points", grid, calibration)
            assert isinstance(points, Points)
            return Follow.of(points, contacts, used, f_switch)
        found = make_method(sensor, name, grid, calibration)
        value = found.choose_lambda([]) if lam is None else lam
        return EachSlot.of(found, contacts, used, value)

    main = made(method)
    # Tables of what slots tell are of contacts that are followed.
    by_place = main if isinstance(main, Follow) else None
    if "information" in names and by_place is None:
        by_place = made("follow")
    policies = {
        name: own[name] if name in own else make_policy(sensor, name, by_place)
        for name in names
    }
    quick = None if cheaper is None else made(cheaper)
    drive = abs(float(sensor.drive_voltage))
    limit = 1.05 * drive if highest is None else float(highest)
    require(limit > 0, "highest", limit, "volts above 0")
    known = Calibration() if calibration is None else calibration
    return Step(sensor, main, quick, policies, used, limit, known)


def check_followed(contacts: int) -> None:
    """Checks how many contacts a step follows. **Raises:** `ValueError` but for 1 to 8."""
    require_whole("contacts", contacts, 1, 8)
