"""Writing logs: MCAP, ROS 1 bags and rosbag2 recordings, by stock libraries."""

from __future__ import annotations

import shutil
import struct
from contextlib import suppress
from pathlib import Path

from formats.logs.definitions import described_channel, standard_store
from formats.recording_sinks import SINKS, Handle, Sink
from formats.ros_messages import RosFields, ros_message
from mapmyworld.errors import LogError
from mapmyworld.types import Message, TransformsMessage

COMPRESSIONS = {
    ".mcap": ("zstd", "lz4", "none"),
    ".bag": ("none", "lz4", "bz2"),
    ".db3": ("none", "zstd"),
}


class LogWriter:
    """Writes messages in the order in which they come; a context manager.

    The path decides: `.mcap` (CDR), `.bag` (ROS 1), `.db3` (a lone rosbag2 file), anything else a
    rosbag2 folder. The log takes its place once it is whole: left by an exception, or killed, the
    writer changes nothing there.
    """

    def __init__(
        self, path: Path | str, *, compression: str | None = None, overwrite: bool = False
    ) -> None:
        """Raises LogError where the path exists, unless `overwrite`, or cannot be written."""
        self.path = Path(path)
        kind = self.path.suffix if self.path.suffix in COMPRESSIONS else ".db3"
        compression = compression or COMPRESSIONS[kind][0]
        if compression not in COMPRESSIONS[kind]:
            raise LogError(
                f"{self.path}: a {kind} log cannot be compressed by {compression}: "
                f"choose {', '.join(COMPRESSIONS[kind])}"
            )
        _require_room(self.path, overwrite)
        self._part = self.path.with_name(f".{self.path.name}.unfinished")
        shutil.rmtree(self._part, ignore_errors=True)  # what a killed writer left
        try:
            self._part.mkdir()
            self.sink: Sink = SINKS[kind](self._part / self.path.name, compression)
        except OSError as error:
            raise LogError(f"{self.path}: cannot be written: {error.strerror or error}") from error
        self._store = standard_store(self.sink.encoding)
        self._handles: dict[tuple[str, str], Handle] = {}

    def write(self, topic: str, message: Message | RosFields, log_time_ns: int) -> None:
        """Appends a message, as the standard ROS type that carries it.

        Raises `LogError` where that cannot hold it.
        """
        type_name, built = ros_message(message, self._store)
        handle, encoding = self._handles.get((topic, type_name)), self.sink.encoding
        if handle is None:
            latching = isinstance(message, TransformsMessage) and message.static
            channel = described_channel(self._store, topic, type_name, encoding, latching)
            handle = self._handles[topic, type_name] = self.sink.add(channel)
        is_ros1 = encoding == "ros1"
        serialise = self._store.serialize_ros1 if is_ros1 else self._store.serialize_cdr
        try:
            data = bytes(serialise(built, type_name))
        except (struct.error, OverflowError, ValueError) as error:
            raise LogError(f"{topic}: a {type_name} cannot hold it ({error})") from None
        self.sink.write(handle, log_time_ns, data)

    def __enter__(self) -> LogWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                part = self.sink.close()  # the whole file or folder
                if self.path.is_dir():
                    shutil.rmtree(self.path)
                elif part.is_dir():
                    self.path.unlink(missing_ok=True)
                part.replace(self.path)
            else:
                with suppress(Exception):  # a full disk takes no last bytes either
                    self.sink.close()
        finally:
            shutil.rmtree(self._part, ignore_errors=True)


def _require_room(path: Path, overwrite: bool) -> None:
    if path.suffix not in COMPRESSIONS:  # the metadata of a recording in a folder name its file
        try:
            path.name.encode()
        except UnicodeEncodeError:
            raise LogError(
                f"{path}: is no UTF-8, which its metadata.yaml must be: give another name"
            ) from None
    if not path.parent.is_dir():
        raise LogError(f"{path}: cannot be written: its folder does not exist")
    if not path.exists():
        return
    if not overwrite:
        raise LogError(f"{path}: exists already: name another file or ask to overwrite it")
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise LogError(f"{path}: not replaced: the folder holds no recording")
