"""Messages of one encoding as another's bytes, without decoding them where that can be helped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from formats.logs.channels import Channel
from formats.logs.definitions import (
    HEADER,
    described_channel,
    recorded_store,
    standard_store,
)
from formats.recording_sinks import McapSink, Sink
from mapmyworld.errors import LogError

# ROS 1's tf type, which ROS 2 knows under its newer name.
_RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


def writing_into(sink: Sink, channel: Channel) -> Callable[[int, bytes], None] | None:
    """What writes the channel's messages, given a log time and their bytes as recorded.

    It raises `LogError` for a damaged message. None where the sink cannot take the channel's
    encoding and must be given typed messages.
    """
    if isinstance(sink, McapSink):
        return partial(sink.write, sink.add(_with_definition(channel)))
    if channel.encoding not in {"ros1", "cdr"}:
        return None
    if channel.encoding == sink.encoding:
        return partial(sink.write, sink.add(_complete(channel)))
    try:
        store = recorded_store(channel) if channel.schema else standard_store(channel.encoding)
        store = _with_header(store, "cdr")  # ROS 2's, which both directions start from
        target = _converted_channel(channel, store, sink.encoding)
    except Exception:  # rosbags promises no family of errors for definitions it cannot take
        return None
    change = store.cdr_to_ros1 if sink.encoding == "ros1" else store.ros1_to_cdr
    handle = sink.add(target)

    def write(log_time_ns: int, data: bytes) -> None:
        try:
            changed = bytes(change(data, channel.type_name))
        except Exception as error:
            raise LogError(f"{channel.topic}: a damaged {channel.type_name}") from error
        sink.write(handle, log_time_ns, changed)

    return write


def _with_definition(channel: Channel) -> Channel:
    """The standard definition for a channel of an older rosbag2, which recorded none."""
    if channel.schema or channel.encoding != "cdr":
        return channel
    try:
        text, _ = standard_store("cdr").generate_msgdef(channel.type_name, ros_version=2)
    except Exception:  # a type that we do not know either
        return channel
    return replace(channel, schema=text.encode(), schema_encoding="ros2msg")


def _complete(channel: Channel) -> Channel:
    """With definition and hash, which bags want, where they can be had."""
    channel = _with_definition(channel)
    if channel.digest or not channel.schema:
        return channel
    try:
        store = recorded_store(channel)
        if channel.encoding == "ros1":
            return replace(channel, digest=store.generate_msgdef(channel.type_name)[1])
        return replace(channel, digest=store.hash_rihs01(channel.type_name))
    except Exception:  # a definition that rosbags cannot take; the bag goes without its hash
        return channel


def _with_header(store: Typestore, encoding: str) -> Typestore:
    """The types with the Header of ROS 1 or 2."""
    changed = get_typestore(Stores.EMPTY)
    types = {
        name: fields for name, fields in store.fielddefs.items() if name not in changed.fielddefs
    }
    changed.register({**types, HEADER: standard_store(encoding).fielddefs[HEADER]})
    return changed


def _converted_channel(channel: Channel, store: Typestore, encoding: str) -> Channel:
    to_ros1 = encoding == "ros1"
    name = channel.type_name if to_ros1 else _RENAMED.get(channel.type_name, channel.type_name)
    if name != channel.type_name:
        store = standard_store("cdr")
    if to_ros1:
        store = _with_header(store, "ros1")
    return described_channel(store, channel.topic, name, encoding, channel.latching)
