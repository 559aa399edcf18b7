"""For each channel: what its messages mean, how to peek at the stamp, how to decode one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from struct import Struct
from typing import Any

from formats.logs import foxglove_decoders, ros_decoders
from formats.logs.channels import Channel, Payload
from formats.logs.message_fields import field, stamp_of
from formats.logs.message_parsers import Parse, RosParser, parser_of
from mapmyworld.errors import LogError
from mapmyworld.types import Message, MessageKind, TextMessage, TransformsMessage

Peek = Callable[[Payload], int | None]
_LITTLE = Struct("<II").unpack_from
_BIG = Struct(">II").unpack_from


@dataclass(frozen=True, slots=True, eq=False)
class ChannelDecoder:
    """How the messages of a channel become ours."""

    kind: MessageKind
    stamp: Peek
    decode: Callable[[Payload, int], Message]
    """Of payload and log time."""


def decoder_for(channel: Channel) -> ChannelDecoder:
    """The decoder of a channel; of kind OTHER where we do not know the type or the encoding.

    It raises `LogError` for a damaged message.
    """
    found = _converter(channel)
    parse = None if found is None else parser_of(channel)
    if found is None or parse is None:
        return ChannelDecoder(MessageKind.OTHER, _no_stamp, partial(_refuse, channel))
    kind, convert = found
    decode = partial(_decode, channel, parse, convert)
    if kind is MessageKind.TEXT:
        return ChannelDecoder(kind, _no_stamp, decode)
    return ChannelDecoder(kind, _stamp_reader(channel, parse, decode), decode)


def _converter(channel: Channel) -> tuple[MessageKind, Callable[[Any], Message]] | None:
    if channel.encoding in {"ros1", "cdr"} and channel.type_name in ros_decoders.CONVERTERS:
        return ros_decoders.CONVERTERS[channel.type_name]
    return foxglove_decoders.CONVERTERS.get(foxglove_decoders.foxglove_name(channel.type_name))


def _decode(
    channel: Channel,
    parse: Parse,
    convert: Callable[[Any], Message],
    data: Payload,
    log_time_ns: int,
) -> Message:
    try:
        message = convert(parse(data))
    except Exception as error:  # three foreign parsers, each with errors of its own
        raise LogError(
            f"{channel.topic}: a damaged {channel.type_name} at log time "
            f"{log_time_ns * 1e-9:.3f} s: {error}"
        ) from error
    if isinstance(message, TransformsMessage) and channel.topic.rstrip("/").endswith("tf_static"):
        return replace(message, static=True)
    return TextMessage(log_time_ns, message.text) if isinstance(message, TextMessage) else message


def _refuse(channel: Channel, _data: Payload, _log_time_ns: int) -> Message:
    raise LogError(
        f"{channel.topic}: messages of type {channel.type_name or '(none)'} "
        f"({channel.encoding or 'no encoding'}) are not decoded"
    )


def _no_stamp(_data: Payload) -> int | None:
    return None


def _stamp_reader(
    channel: Channel, parse: Parse, decode: Callable[[Payload, int], Message]
) -> Peek:
    """What finds the stamp in some of the bytes where that can be, else decodes the message."""
    at = parse.stamp_at() if isinstance(parse, RosParser) else None
    if at is not None:
        return partial(_header_stamp, at, channel.encoding == "ros1")
    return partial(_parsed_stamp, parse, decode)


def _parsed_stamp(
    parse: Parse, decode: Callable[[Payload, int], Message], data: Payload
) -> int | None:
    """Of the message's own field, before pixels and points are made of the others."""
    try:
        value = parse(data)
        if field(value, "timestamp") is not None:
            return stamp_of(value)
        return decode(data, 0).stamp_ns
    except Exception:  # damaged; decoding will say so
        return None


def _header_stamp(at: int, is_ros1: bool, data: Payload) -> int | None:
    if len(data) < at + 8:
        return None
    seconds, nanoseconds = (_LITTLE if is_ros1 or data[1] else _BIG)(data, at)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
