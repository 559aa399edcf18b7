"""For each channel: what its messages mean, how to peek at the stamp, how to decode one."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from struct import Struct

from formats.logs.channels import Channel, Payload
from formats.logs.ros_decoders import (
    STAMPED,
    TEXT,
    TRANSFORMS,
    text,
    transforms,
)
from formats.logs.wire import ROS1, Wire, cdr_wire
from mapmyworld.errors import LogError
from mapmyworld.types import Message, MessageKind

# What decoders meet in damaged messages.
DECODE_ERRORS = (
    ValueError,
    struct.error,
    IndexError,
    KeyError,
    TypeError,
    AttributeError,
    OverflowError,
)
_LITTLE = Struct("<II").unpack_from
_BIG = Struct(">II").unpack_from
_TF_COUNT_BYTES = 4


@dataclass(frozen=True, slots=True, eq=False)
class ChannelDecoder:
    """How the messages of a channel become ours."""

    kind: MessageKind
    stamp: Callable[[Payload], int | None]
    decode: Callable[[Payload, int], Message]
    """Of payload and log time."""


def decoder_for(channel: Channel) -> ChannelDecoder:
    """The decoder of a channel; of kind OTHER where we do not know the type or the encoding."""
    if channel.encoding in {"ros1", "cdr"}:
        found = _ros_decoder(channel)
        if found is not None:
            return found
    if "foxglove" in channel.type_name:
        from formats.logs.foxglove_encodings import foxglove_decoder

        parts = foxglove_decoder(channel)
        if parts is not None:
            return ChannelDecoder(*parts)
    return ChannelDecoder(MessageKind.OTHER, _no_stamp, partial(_refuse, channel))


def _ros_decoder(channel: Channel) -> ChannelDecoder | None:
    kind = ros_kind(channel.type_name)
    if kind is MessageKind.OTHER:
        return None
    standardise = _standardiser(channel)
    decode = _decode(channel, standardise)
    if standardise is not None:
        return ChannelDecoder(kind, partial(_slow_stamp, decode), decode)
    if kind is MessageKind.TEXT:
        return ChannelDecoder(kind, _no_stamp, decode)
    if kind is MessageKind.TRANSFORMS:
        peek = _ros1_tf_stamp if channel.encoding == "ros1" else _cdr_tf_stamp
    else:
        peek = _ros1_stamp if channel.encoding == "ros1" else _cdr_stamp
    return ChannelDecoder(kind, peek, decode)


def ros_kind(type_name: str) -> MessageKind:
    """What a ROS type means for mapping."""
    if type_name in TRANSFORMS:
        return MessageKind.TRANSFORMS
    if type_name == TEXT:
        return MessageKind.TEXT
    return STAMPED[type_name][0] if type_name in STAMPED else MessageKind.OTHER


Body = Callable[[Wire, Payload, int], Message]


def _body(channel: Channel) -> Body:
    """What makes a message of a wire format, its bytes and the log time."""
    if channel.type_name in TRANSFORMS:
        static = channel.topic.rstrip("/").endswith("tf_static")
        return lambda wire, data, _: transforms(wire, data, static=static)
    if channel.type_name == TEXT:
        return text
    function = STAMPED[channel.type_name][1]
    return lambda wire, data, _: function(wire, data)


def _standardiser(channel: Channel) -> Callable[[bytes], bytes] | None:
    """None where messages are laid out as usual, or where the definition cannot be read."""
    if not channel.schema.strip():
        return None
    from formats.logs.definitions import DEFINITION_ERRORS, is_standard, standardiser

    try:
        return None if is_standard(channel) else standardiser(channel)
    except DEFINITION_ERRORS:
        return None


def _decode(
    channel: Channel, standardise: Callable[[bytes], bytes] | None
) -> Callable[[Payload, int], Message]:
    body = _body(channel)

    def decode_ros1(data: Payload, log_time_ns: int) -> Message:
        try:
            return body(ROS1, data, log_time_ns)
        except DECODE_ERRORS as error:
            raise _damaged(channel, log_time_ns, error) from error

    def decode_cdr(data: Payload, log_time_ns: int) -> Message:
        try:
            if standardise is not None:
                data = _standardised(standardise, data)
            return body(cdr_wire(data), data, log_time_ns)
        except DECODE_ERRORS as error:
            raise _damaged(channel, log_time_ns, error) from error

    # Messages that were brought into standard layout are CDR, whatever they were before.
    return decode_ros1 if channel.encoding == "ros1" and standardise is None else decode_cdr


def _damaged(channel: Channel, log_time_ns: int, error: Exception) -> LogError:
    return LogError(
        f"{channel.topic}: a damaged {channel.type_name} at log time "
        f"{log_time_ns * 1e-9:.3f} s: {error}"
    )


def _standardised(standardise: Callable[[bytes], bytes], data: Payload) -> bytes:
    try:
        return standardise(bytes(data))
    except Exception as error:  # rosbags promises no family of errors here
        raise ValueError(str(error)) from error


def _refuse(channel: Channel, _data: Payload, _log_time_ns: int) -> Message:
    raise LogError(
        f"{channel.topic}: messages of type {channel.type_name or '(none)'} "
        f"({channel.encoding or 'no encoding'}) are not decoded"
    )


def _no_stamp(_data: Payload) -> int | None:
    return None


def _ros1_stamp(data: Payload) -> int | None:
    if len(data) < 12:
        return None
    seconds, nanoseconds = _LITTLE(data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _cdr_stamp(data: Payload) -> int | None:
    if len(data) < 12:
        return None
    seconds, nanoseconds = (_LITTLE if data[1] else _BIG)(data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _ros1_tf_stamp(data: Payload) -> int | None:
    """Of the first transform."""
    return _ros1_stamp(data[_TF_COUNT_BYTES:])


def _cdr_tf_stamp(data: Payload) -> int | None:
    if len(data) < 16:
        return None
    seconds, nanoseconds = (_LITTLE if data[1] else _BIG)(data, 8)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _slow_stamp(decode: Callable[[Payload, int], Message], data: Payload) -> int | None:
    try:
        return decode(data, 0).stamp_ns
    except LogError:
        return None
