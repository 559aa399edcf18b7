"""Definitions that claim more than any message holds are put aside, at once."""

from __future__ import annotations

import time

import pytest
from log_builders import Make, serialised

from formats.logs.channels import Channel
from formats.logs.decoding import decoder_for
from mapmyworld.types import LaserScanMessage

_RULE = "=" * 80 + "\n"
_SCAN = "sensor_msgs/msg/LaserScan"
STAMP = 1_700_000_000_250_000_000


def doubling(depth: int) -> str:
    """A type of two of a type of two, and so on: 2^depth values."""
    text = "own/A0 x\nown/A0 y\n"
    for i in range(depth):
        text += f"{_RULE}MSG: own/A{i}\nown/A{i + 1} x\nown/A{i + 1} y\n"
    return text + f"{_RULE}MSG: own/A{depth}\nfloat64 x\n"


BOMBS = {
    "doubled": doubling(45),
    "contains itself": "sensor_msgs/LaserScan a\nsensor_msgs/LaserScan b\n",
    "array of messages": f"own/P[99999999999] x\n{_RULE}MSG: own/P\nfloat64 x\n",
    "array of texts": "string[99999999] x\n",
    "sequence of nothing": f"own/P[] x\n{_RULE}MSG: own/P\n",
    "array of nothing": f"own/P[99999999] x\n{_RULE}MSG: own/P\n",
    "many fields": "".join(f"float64 x{i}\n" for i in range(5000)),
    "a constant of a gigabyte": "module a { const long A = 1 << 8000000000; };",
    "products of products": "module a { const long A = 9; const long B = A * A; };",
    "strings in IDL": "@verbatim(language=x, text=" + '"a" ' * 10_000 + ")",
}


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("text", BOMBS.values(), ids=BOMBS)
def test_a_definition_beyond_sense_leaves_the_standard_one(text: str, ros: int) -> None:
    encoding, schema = ("ros1", "ros1msg") if ros == 1 else ("cdr", "ros2msg")
    if text.startswith(("@", "module")):
        schema = "ros2idl"
    data = serialised(ros, ("", _SCAN, 0, Make(ros).scan(STAMP)))
    started = time.process_time()
    decoder = decoder_for(Channel("/scan", _SCAN, encoding, schema, text.encode()))
    scan = decoder.message(data, 0).decode()
    assert time.process_time() - started < 3.0
    assert isinstance(scan, LaserScanMessage)
    assert scan.stamp_ns == STAMP


def test_a_message_may_claim_no_length_without_bytes() -> None:
    """Two thousand million elements of no byte each."""
    text = f"own/P[] x\n{_RULE}MSG: own/P\n"
    decoder = decoder_for(Channel("/scan", _SCAN, "ros1", "ros1msg", text.encode()))
    started = time.process_time()
    decoder.message(b"\xff\xff\xff\x7f" + bytes(200), 0)
    assert time.process_time() - started < 3.0


def test_large_arrays_of_numbers_are_as_good_as_any() -> None:
    text = (
        "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n"
        f"float64[5000] spectrum\n{_RULE}MSG: std_msgs/Header\nuint32 seq\ntime stamp\n"
        "string frame_id\n"
    )
    decoder = decoder_for(Channel("/scan", _SCAN, "ros1", "ros1msg", text.encode()))
    header = bytes(4) + (7).to_bytes(4, "little") + bytes(4) + (1).to_bytes(4, "little") + b"a"
    scan = decoder.message(header + bytes(12) + bytes(40_000), 0).decode()
    assert isinstance(scan, LaserScanMessage)
    assert (scan.stamp_ns, scan.frame_id) == (7_000_000_000, "a")
