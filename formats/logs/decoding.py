"""For each channel: what its messages mean, and how its bytes become one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

from formats.logs import foxglove_decoders, ros_decoders
from formats.logs.channels import Channel
from formats.logs.message_fields import field, stamp_of
from formats.logs.message_parsers import Parse, header_parser_of, parser_of
from mapmyworld.errors import LogError
from mapmyworld.types import Message, MessageKind, RawMessage, TextMessage, TransformsMessage


@dataclass(frozen=True, slots=True, eq=False)
class ChannelDecoder:
    """How the messages of a channel become ours; of kind OTHER where we do not know how."""

    channel: Channel
    kind: MessageKind
    parse: Parse
    convert: Callable[[Any], Message]
    header: Parse | None = None
    """Of the header that messages begin with, if they do."""

    def message(self, data: bytes, log_time_ns: int) -> RawMessage:
        """Its header is parsed at once, all else when it is decoded; without one, all at once.

        What is damaged up to its stamp has none, and raises `LogError` when it is decoded.
        """
        stamp_ns: int | None = None
        try:
            value = self.parse(data) if self.header is None else None
            stamp_ns = _stamp(value) if self.header is None else stamp_of(self.header(data))
            decode = partial(self._decoded, data, value, log_time_ns)
        except Exception as error:  # three foreign parsers, each with errors of its own
            decode = partial(self._refuse, str(error), log_time_ns)
        return RawMessage(self.channel.topic, self.kind, log_time_ns, stamp_ns, decode)

    def _decoded(self, data: bytes, value: Any, log_time_ns: int) -> Message:
        try:
            message = self.convert(self.parse(data) if value is None else value)
        except Exception as error:
            return self._refuse(str(error), log_time_ns)
        if isinstance(message, TransformsMessage):
            is_static = self.channel.topic.rstrip("/").endswith("tf_static")
            return replace(message, static=is_static)
        if isinstance(message, TextMessage):
            return TextMessage(log_time_ns, message.text)
        return message

    def _refuse(self, why: str, log_time_ns: int) -> Message:
        channel = self.channel
        if self.kind is MessageKind.OTHER:
            raise LogError(
                f"{channel.topic}: messages of type {channel.type_name or '(none)'} "
                f"({channel.encoding or 'no encoding'}) are not decoded"
            )
        raise LogError(
            f"{channel.topic}: a damaged {channel.type_name} at log time "
            f"{log_time_ns * 1e-9:.3f} s: {why}"
        )


@lru_cache(maxsize=1024)
def decoder_for(channel: Channel) -> ChannelDecoder:
    """The decoder of a channel; of kind OTHER where we do not know the type or the encoding."""
    name, found = channel.type_name, None
    if channel.encoding in {"ros1", "cdr"}:
        found = ros_decoders.CONVERTERS.get(name)
    found = found or foxglove_decoders.CONVERTERS.get(foxglove_decoders.foxglove_name(name))
    parse = None if found is None else parser_of(channel)
    if found is None or parse is None:
        return ChannelDecoder(channel, MessageKind.OTHER, bytes, _unknown)
    return ChannelDecoder(channel, found[0], parse, found[1], header_parser_of(channel))


def _unknown(_value: Any) -> Message:
    raise ValueError("its type is not known")


def _stamp(value: Any) -> int | None:
    """Of the header, or of the first transform's; None where there is no time."""
    transforms = field(value, "transforms", ())
    first = transforms[0] if len(transforms) else value
    header = field(first, "header", first)
    has_time = hasattr(header, "stamp") or hasattr(header, "timestamp")
    return stamp_of(header) if has_time else None
