"""OSC over UDP, for sound and light."""

from typing import Any

from tomojax.events import Event
from tomojax.hardware.loop import SlotRing
from tomojax.hardware.sinks._rows import goes_out, LiveRow
from tomojax.hardware.sinks._where import Where


class OscSink:
    """Sends a bundle for each row, and a message for each event.

    A bundle has /tomojax/count, and /tomojax/contact for each contact. A contact has its
    number, x, y (m), conductance (S) and force (N). The messages /tomojax/touch_down and
    /tomojax/lift_off have the same values. An unknown force is NaN.
    """

    def __init__(self, where: Where, ring: SlotRing):
        from pythonosc.udp_client import UDPClient

        self._client = UDPClient(*where.address, allow_broadcast=True)

    def put(self, row: LiveRow) -> bool:
        from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder

        bundle = OscBundleBuilder(IMMEDIATELY)  # pyright: ignore (the library's own value)
        bundle.add_content(_message("count", [len(row.contacts)]))
        for one in row.contacts:
            bundle.add_content(_message("contact", list(one)))
        return goes_out(self._client.send, bundle.build())

    def event(self, event: Event, row: LiveRow | None) -> None:
        told = [event.contact, *event.xy, event.conductance, event.force]
        goes_out(self._client.send, _message(event.kind, told))

    def close(self) -> None:
        pass


def _message(name: str, values: list[Any]) -> Any:
    from pythonosc.osc_message_builder import OscMessageBuilder

    made = OscMessageBuilder(f"/tomojax/{name}")
    for value in values:
        kind = made.ARG_TYPE_INT if isinstance(value, int) else made.ARG_TYPE_FLOAT
        made.add_arg(value, kind)
    return made.build()
