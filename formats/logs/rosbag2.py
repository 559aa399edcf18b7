"""rosbag2 recordings in SQLite: .db3 files, and the folders around them."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing
from pathlib import Path

import zstandard

from formats.limits import limits
from formats.logs.block_files import DamagedBlockError
from formats.logs.channels import Block, Channel, Found, Index, normalised_type
from formats.logs.compression import decompress, decompress_beginning
from formats.logs.files import UnpackedFile
from formats.logs.mcap_records import is_transient_local
from formats.logs.recorded_log import RecordedLog
from formats.logs.sqlite_pages import Salvage, salvage
from formats.stored_tables import stored_tables
from mapmyworld.errors import LogError

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # never the start of a CDR message
_LISTED = re.compile(r"^\s*-\s*['\"]?([^'\"\n]+?\.(?:db3|mcap)(?:\.zstd)?)['\"]?\s*$", re.MULTILINE)


def listed_files(metadata: Path) -> list[Path]:
    """The files that a metadata.yaml names, in its order; missing ones included."""
    text = metadata.read_text("utf-8", "replace")
    names = dict.fromkeys(Path(name).name for name in _LISTED.findall(text))
    return [metadata.parent / name for name in names]


_LAST_ROW = (1 << 63) - 1  # that SQLite can number
_RUN_BYTES = 1 << 20  # of rows that are read at once
# SQLite quotes the damaged bytes in its message, which Python then cannot read.
SQLITE_ERRORS = (sqlite3.Error, UnicodeDecodeError)


def connect_read_only(path: Path) -> sqlite3.Connection:
    """The database, untouched. With a write-ahead log beside it, as a killed recorder leaves it,
    that is read as well; else nothing is locked, so that read-only media work.
    """
    wal = path.with_name(path.name + "-wal")
    options = "mode=ro" if wal.is_file() and wal.stat().st_size else "mode=ro&immutable=1"
    uri = f"{path.resolve().as_uri()}?{options}"
    database = sqlite3.connect(uri, uri=True, check_same_thread=False)
    # What is no UTF-8 in a damaged database must not end the reading.
    database.text_factory = lambda data: data.decode("utf-8", "replace")
    return database


def one_line(error: Exception) -> str:
    """SQLite's words on an error may quote the damaged bytes, and at length."""
    return " ".join(str(error).split())[:120]


Row = tuple[int, object, object, object]
"""Its number, its time in ns, its topic and its data."""


class SqliteBag(RecordedLog):
    """One .db3 file. A block is a run of rows, which are numbered as they were written."""

    def __init__(self, file: UnpackedFile, name: str) -> None:
        super().__init__(file, name)
        self._salvage: Salvage | None = None
        """The file page by page, where SQLite does not read all of it."""

    def _opened(self) -> AbstractContextManager[sqlite3.Connection]:
        return closing(connect_read_only(self._file.plain()))

    def _scan(self, source: sqlite3.Connection) -> Index:
        try:
            (page_bytes,) = source.execute("PRAGMA page_size").fetchone()
            if self._file.plain().stat().st_size % page_bytes:
                raise ValueError("it ends within a page")  # SQLite takes the rest for zeros
            return self._with_runs(_topics(source), self._rows(source))
        except (*SQLITE_ERRORS, ValueError) as error:
            return self._with_runs(self._topics_of_pages(error), self._rows(source))

    def _messages(self, source: sqlite3.Connection, block: Block) -> list[Found]:
        try:
            rows = self._rows(source, block.offset, block.offset + block.length - 1)
            return [message for _, message in _sound(rows, Index())]
        except SQLITE_ERRORS as error:
            raise DamagedBlockError(f"its rows cannot be read ({one_line(error)})") from error

    def _with_runs(self, index: Index, rows: Iterator[Row]) -> Index:
        """The same index with the messages of its topics."""
        run, first, last, size = list[Found](), 0, 0, 0
        for number, message in _sound(rows, index):
            if run and size + len(message[2]) > _RUN_BYTES:
                index.add(run, first, last + 1 - first)
                run, size = [], 0
            first, last = number if not run else first, number
            run.append(message)
            size += len(message[2])
        index.add(run, first, last + 1 - first)
        return index

    def _rows(
        self, database: sqlite3.Connection, first: int | None = None, last: int = _LAST_ROW
    ) -> Iterator[Row]:
        """Rows as they were written; all of them without a first one."""
        if self._salvage is not None:
            return self._salvage.rows(-_LAST_ROW if first is None else first, last)
        too_much = f"typeof(data) = 'blob' AND length(data) > {limits().chunk_bytes}"
        data = f"CASE WHEN {too_much} THEN length(data) ELSE data END"
        # A search by row ends without a word where a file is cut; to go through all does not.
        where = "" if first is None else f"WHERE rowid BETWEEN {first} AND {last}"
        return database.execute(
            f"SELECT rowid, timestamp, topic_id, {data} FROM messages {where} ORDER BY rowid"
        )

    def _topics_of_pages(self, error: Exception) -> Index:
        """Takes the file page by page from now on; LogError where there is nothing in it."""
        try:
            found = salvage(self._file.plain())
        except (OSError, ValueError):
            found = None
        if found is None or not found.messages or not found.topics:
            raise LogError(
                f"{self.path}: damaged or no rosbag2 database ({one_line(error)}): "
                "try `sqlite3 FILE .recover`",
                problems=self._file.problems(),
            ) from error
        self._salvage = found
        damage = f"{self.path}: damaged ({one_line(error)}): {found.reported}"
        index = Index(problems=[damage])
        for key, (_, topic, kind, encoding, *rest) in found.topics.items():
            name, profiles = normalised_type(str(kind)), str(rest[0] if rest else "")
            latching = is_transient_local(profiles)
            index.channels[key] = Channel(str(topic), name, str(encoding), latching=latching)
        return index


def _sound(rows: Iterator[Row], index: Index) -> Iterator[tuple[int, Found]]:
    """Rows that are messages, by their numbers; others are reported."""
    untimed = 0
    for number, time, key, cell in rows:
        if not (isinstance(time, int) and isinstance(key, int)):
            untimed += 1
            continue
        try:
            yield number, (time, key, _plain(cell))
        except DamagedBlockError as error:
            topic = index.channels[key].topic if key in index.channels else f"topic {key}"
            index.problems.append(f"a message of {topic}: {error}")
    if untimed:
        index.problems.append(f"{untimed} message(s) have no time or no topic and are left out")


def _plain(data: object) -> bytes:
    if isinstance(data, int) and data > limits().chunk_bytes:
        raise DamagedBlockError(f"it claims {data} bytes, more than limits.chunk_mb allows")
    if not isinstance(data, bytes):
        raise DamagedBlockError("its data are missing")
    if not data.startswith(ZSTD_MAGIC):
        return data
    size = zstandard.frame_content_size(data)
    if 0 <= size <= limits().chunk_bytes:
        return decompress(data, "zstd", size)
    return decompress_beginning(data, "zstd", limits().chunk_bytes)


def _topics(database: sqlite3.Connection) -> Index:
    index, tables = Index(), stored_tables(database)
    if not {"topics", "messages"} <= tables:
        raise ValueError("no tables of topics and messages")
    columns = {str(row[1]) for row in database.execute("PRAGMA table_info(topics)")}
    definitions = _definitions(database) if "message_definitions" in tables else {}
    qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
    digest = "type_description_hash" if "type_description_hash" in columns else "''"
    query = f"SELECT id, name, type, serialization_format, {qos}, {digest} FROM topics"
    for key, topic, kind, encoding, profiles, hashed in database.execute(query):
        if not isinstance(key, int):
            index.problems.append(f"topic {topic} has no number: its messages are left out")
            continue
        schema_encoding, schema = definitions.get(str(kind), ("", b""))
        index.channels[key] = Channel(
            str(topic),
            normalised_type(str(kind)),
            str(encoding),
            schema_encoding,
            schema,
            str(hashed or ""),
            is_transient_local(str(profiles or "")),
            {"offered_qos_profiles": str(profiles or "")},
        )
    return index


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, bytes]]:
    """Type -> (encoding, definition), where the recording keeps them (since ROS 2 Iron)."""
    try:
        rows = database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        ).fetchall()
    except SQLITE_ERRORS:
        return {}
    return {str(kind): (str(encoding), str(text).encode()) for kind, encoding, text in rows}
