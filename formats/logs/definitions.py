"""Message definitions: those that ROS has, and those that a recording brings, within reason.

Parsing them, and reading messages by them, is rosbags' work.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from formats.logs.channels import Channel

_TF_MESSAGE = "geometry_msgs/TransformStamped[] transforms\n"
_TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
HEADER = "std_msgs/msg/Header"
# No type that we read comes near these; beyond them, parsing and the code that rosbags makes of a
# definition, value by value, take minutes and gigabytes.
_MOST_TEXT = 1 << 16  # bytes of a definition
_MOST_QUOTES = 4000  # in IDL, whose comments are strings
_COMPUTES = re.compile(r"<<|(?<!/)\*(?!/)")  # 1 << 80000000000 is a number of 10 GB
_MOST_VALUES = 1000  # of basic types in a message, where every sequence holds one element
_DEEPEST = 50  # types within types
_NOTHING = "structure_needs_at_least_one_member"  # rosbags' only field of a type without fields


@cache
def standard_store(encoding: str) -> Typestore:
    """The types that ROS itself defines, with tf's: 1 Noetic ("ros1"), or 2 Humble ("cdr"), which
    all later ones lay out alike.
    """
    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    for name in _TF_TYPES:
        if name not in store.fielddefs:
            store.register(get_types_from_msg(_TF_MESSAGE, name))
    return store


def described_channel(
    store: Typestore, topic: str, type_name: str, encoding: str, latching: bool
) -> Channel:
    """A channel of "ros1" or "cdr" with its type's definition and hash, as this store has it."""
    version = 1 if encoding == "ros1" else 2
    text, digest = store.generate_msgdef(type_name, ros_version=version)
    digest = digest if version == 1 else store.hash_rihs01(type_name)
    kind = f"ros{version}msg"
    return Channel(topic, type_name, encoding, kind, text.encode(), digest, latching)


def recorded_store(channel: Channel) -> Typestore:
    """The types that the channel's own definition names.

    Raises rosbags' errors, or ValueError, where the definition cannot be parsed or is beyond
    sense.
    """
    text = channel.schema.decode("utf-8", "replace")
    if len(text) > _MOST_TEXT or text.count('"') > _MOST_QUOTES:
        raise ValueError(f"a definition of {len(text)} characters")
    if channel.schema_encoding == "ros2idl" or text.startswith("=" * 80 + "\nIDL: "):
        if "const" in text and _COMPUTES.search(text):
            raise ValueError("constants that are computed, to whatever length")
        types = get_types_from_idl(text)
    else:
        types = get_types_from_msg(text, channel.type_name)
    store = get_typestore(Stores.EMPTY)
    for known in store.fielddefs:
        types.pop(known, None)
    if HEADER not in types:
        types[HEADER] = standard_store(channel.encoding).fielddefs[HEADER]
    store.register(types)
    if values_of(store, channel.type_name, {}) > _MOST_VALUES:
        raise ValueError(f"a {channel.type_name} of more than {_MOST_VALUES} values")
    return store


def values_of(store: Typestore, type_name: str, known: dict[str, int], depth: int = 0) -> int:
    """How many basic values a message holds where every sequence has one element.

    `known` holds the types counted so far: a type of two of a type of two, thirty times over, is
    a short text and a billion values.
    """
    if depth > _DEEPEST:
        raise ValueError(f"{type_name} contains itself")
    if type_name not in known:
        fields = [field for name, field in store.fielddefs[type_name][1] if name != _NOTHING]
        known[type_name] = sum(_values_of(store, field, known, depth) for field in fields)
    return known[type_name]


def _values_of(store: Typestore, field: Any, known: dict[str, int], depth: int) -> int:
    kind, what = field
    if kind == Nodetype.BASE:
        return 1
    if kind == Nodetype.NAME:
        return values_of(store, what, known, depth + 1)
    element, size = what[0], int(what[1])
    inside = _values_of(store, element, known, depth)
    if kind == Nodetype.ARRAY:  # arrays of numbers are read at once, whatever their size
        is_number = element[0] == Nodetype.BASE and element[1][0] not in ("string", "wstring")
        return min(size, 1) if is_number else size * max(inside, 1)
    if inside == 0:
        raise ValueError("a sequence of messages without content, which may claim any length")
    return inside
