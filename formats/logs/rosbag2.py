"""rosbag2 recordings in SQLite: .db3 files, and the folders around them."""

from __future__ import annotations

import heapq
import re
import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing
from operator import itemgetter
from pathlib import Path

import zstandard

from formats.limits import limits
from formats.logs.block_files import DamagedBlockError
from formats.logs.channels import Block, Channel, Index, Record, normalised_type
from formats.logs.clock_steps import ClockStep
from formats.logs.compression import decompress, decompress_beginning
from formats.logs.files import UnpackedFile
from formats.logs.mcap_records import is_transient_local
from formats.logs.rosbag2_clock import IS_TIMED, NO_STEP, RowClock, read_clock
from formats.logs.rosbag2_salvage import Salvage, salvage
from formats.stored_tables import stored_tables
from mapmyworld.errors import LogError

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # never the start of a CDR message
_LISTED = re.compile(r"^\s*-\s*['\"]?([^'\"\n]+?\.(?:db3|mcap)(?:\.zstd)?)['\"]?\s*$", re.MULTILINE)


def listed_files(metadata: Path) -> list[Path]:
    """The files that a metadata.yaml names, in its order; missing ones included."""
    text = metadata.read_text("utf-8", "replace")
    names = dict.fromkeys(Path(name).name for name in _LISTED.findall(text))
    return [metadata.parent / name for name in names]


_MENDED = "timestamp + (id >= :first) * :back"
_SPANS = (
    f"SELECT topic_id, {IS_TIMED}, count(*), min({_MENDED}), max({_MENDED})"
    " FROM messages GROUP BY 1, 2"
)
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
    database.text_factory = lossy_text
    return database


def lossy_text(data: bytes) -> str:
    """Text of a damaged database: what is no UTF-8 must not end the reading."""
    return data.decode("utf-8", "replace")


def one_line(error: Exception) -> str:
    """SQLite's words on an error may quote the damaged bytes, and at length."""
    return " ".join(str(error).split())[:120]


class SqliteBag:
    """One .db3 file."""

    def __init__(self, file: UnpackedFile, name: str = "rosbag2 (sqlite3)") -> None:
        self._file, self.path = file, file.path
        self.name = name
        self._index: Index | None = None
        self._clock = NO_STEP
        self._salvage: Salvage | None = None
        self._losses: list[str] = []

    def files(self) -> tuple[Path, ...]:
        return (self.path,)

    def losses(self) -> tuple[str, ...]:
        return (*self.index().problems, *self._losses)

    @property
    def clock_step(self) -> ClockStep | None:
        """Where the clock was set back; known with the index: rows are numbered as written."""
        return self._clock.step

    def index(self) -> Index:
        if self._index is None:
            try:
                with closing(self._connect()) as database:
                    index = _read_index(database)
                    self._clock = read_clock(database, index)
                    _read_spans(database, index, self._clock)
                self._index = index
                if self._clock.step is not None:
                    self._clock.step.report(self.path, index.problems)
            except (*SQLITE_ERRORS, ValueError) as error:
                self._index = self._salvaged_index(error)
            self._index.problems[:0] = self._file.problems()
        return self._index

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        index = self.index()
        wanted = {
            key: channel
            for key, channel in index.channels.items()
            if topics is None or channel.topic in topics
        }
        self._losses = []
        with closing(self._connect()) as database:
            rows = self._rows(database, wanted) if self._salvage is None else self._rest(wanted)
            for time, key, data in rows:
                try:
                    yield time, wanted[key], _plain(data)
                except DamagedBlockError as error:
                    self._losses.append(f"{self.path}: a message of {wanted[key].topic}: {error}")

    def _rows(
        self, database: sqlite3.Connection, wanted: Collection[int]
    ) -> Iterator[tuple[int, int, object]]:
        """Rows in order; where the file is damaged, what follows is looked for page by page."""
        marks = ",".join(str(int(key)) for key in wanted)
        too_much = f"typeof(data) = 'blob' AND length(data) > {limits().chunk_bytes}"
        data = f"CASE WHEN {too_much} THEN length(data) ELSE data END"
        # A search by row, which + keeps SQLite from, ends without a word where a file is cut.
        query = (
            f"SELECT timestamp, id, topic_id, {data} FROM messages WHERE topic_id IN ({marks})"
            f" AND {IS_TIMED} AND +id BETWEEN ? AND ? ORDER BY timestamp, id"
        )

        def run(first: int, last: int, back_ns: int) -> Iterator[tuple[int, int, int, object]]:
            for time, row, key, cell in database.execute(query, (first, last)):
                yield time + back_ns, row, key, cell

        runs = [run(*span) for span in self._clock.runs()]
        seen, last_ns = 0, 0
        try:
            for time, row, key, cell in heapq.merge(*runs, key=itemgetter(0, 1)):
                seen, last_ns = row, time
                yield time, key, cell
        except SQLITE_ERRORS as error:
            where = f"{self.path}: damaged after {last_ns * 1e-9:.2f} s ({one_line(error)})"
            self._salvage = salvage(self._file.plain())
            self.index().problems.append(
                f"{where}: {self._salvage.reported}"
            )  # for later passes too
            yield from self._rest(wanted, (last_ns, seen))

    def _rest(
        self, wanted: Collection[int], after: tuple[int, int] = (0, -1)
    ) -> Iterator[tuple[int, int, object]]:
        """What was found page by page of later rows; a time of 0 is no time."""
        assert self._salvage is not None
        found = [
            (self._clock.mended(time, row), row, key, cell)
            for time, row, key, cell in self._salvage.messages
        ]
        for time, row, key, cell in sorted(found, key=itemgetter(0, 1)):
            if key in wanted and (time, row) > after:
                yield time, key, self._salvage.data(cell)

    def _salvaged_index(self, error: Exception) -> Index:
        """The index of what is found page by page; LogError where that is nothing."""
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
        index, self._salvage = Index(), found
        index.problems.append(f"{self.path}: damaged ({one_line(error)}): {found.reported}")
        for key, (_, topic, kind, encoding, *rest) in found.topics.items():
            name, profiles = normalised_type(str(kind)), str(rest[0] if rest else "")
            latching = is_transient_local(profiles)
            index.channels[key] = Channel(str(topic), name, str(encoding), latching=latching)
        _add_spans(index, found)
        return index

    def _connect(self) -> sqlite3.Connection:
        return connect_read_only(self._file.plain())


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


def _read_index(database: sqlite3.Connection) -> Index:
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


def _read_spans(database: sqlite3.Connection, index: Index, clock: RowClock) -> None:
    """How many messages each topic has, and when."""
    spans = database.execute(_SPANS, {"first": clock.first_row, "back": clock.back_ns})
    for key, is_timed, count, first, last in spans:
        if key in index.channels and is_timed:
            index.counts[key] = count
            index.blocks.append(Block(0, 0, first, last, frozenset({key})))
        elif key in index.channels:
            topic = index.channels[key].topic
            index.problems.append(f"{count} message(s) of {topic} have no time and are left out")
        elif isinstance(key, int):
            index.problems.append(
                f"{count} message(s) of topic number {key}, which is not listed, are left out"
            )


def _add_spans(index: Index, found: Salvage) -> None:
    """How many messages each topic has, and when."""
    for key in index.channels:
        times = [time for time, _, topic, _ in found.messages if topic == key]
        if times:
            index.counts[key] = len(times)
            index.blocks.append(Block(0, 0, min(times), max(times), frozenset({key})))


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, bytes]]:
    """Type -> (encoding, definition), where the recording keeps them (since ROS 2 Iron)."""
    try:
        rows = database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        ).fetchall()
    except SQLITE_ERRORS:
        return {}
    return {str(kind): (str(encoding), str(text).encode()) for kind, encoding, text in rows}
