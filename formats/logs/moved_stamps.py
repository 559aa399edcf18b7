"""Header stamps of a clock that was set back, moved as the log times were."""

from __future__ import annotations

from dataclasses import replace

from mapmyworld.types import Message, RawMessage, TransformsMessage


def moved_stamps(raw: RawMessage, back_ns: int) -> RawMessage:
    """The message, its stamps moved by `back_ns` where they lie that much before its log time.

    So those from before the step stay, and those of another clock, which was not set.
    """
    stamp_ns = raw.stamp_ns
    if stamp_ns is None or abs(raw.log_time_ns - stamp_ns - back_ns) >= 0.5 * back_ns:
        return raw
    return replace(raw, stamp_ns=stamp_ns + back_ns, decode=lambda: _moved(raw.decode(), back_ns))


def _moved(message: Message, back_ns: int) -> Message:
    if isinstance(message, TransformsMessage):
        moved = (replace(t, stamp_ns=t.stamp_ns + back_ns) for t in message.transforms)
        return replace(message, transforms=tuple(moved))
    return replace(message, stamp_ns=message.stamp_ns + back_ns)
