"""One kind of log as another: bytes kept where the output takes them, else encoded anew."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from formats.logs.channels import Channel
from formats.logs.decoding import decoder_for
from formats.logs.merged import MergedLog
from formats.logs.recorded_log import RecordedLog
from formats.recording_files import LogWriter
from formats.transcoding import writing_into
from mapmyworld.errors import LogError
from mapmyworld.types import LogSource, MessageKind, RawMessage
from mapmyworld.types.seams import Progress


@dataclass(frozen=True, slots=True)
class Conversion:
    """What was written, and what could not be."""

    messages: int
    duration_s: float
    losses: tuple[str, ...]
    """What is missing in it, and what it states as fact though it had to be assumed."""


def convert_log(
    log: LogSource,
    output: Path,
    *,
    topics: frozenset[str] | None = None,
    start_s: float = 0.0,
    duration_s: float | None = None,
    compression: str | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Conversion:
    """Writes messages of `log`, in its order and with its log times, to `output`.

    Those of `topics`, from `start_s` after the first one on, for `duration_s`. Raises LogError
    where there are none, or the output cannot be written.
    """
    info = log.info()
    known = {topic.topic for topic in info.topics}
    if missing := sorted((topics or frozenset()) - known):
        raise LogError(
            f"no topic {', '.join(missing)} in the log: it has {', '.join(sorted(known))}"
        )
    if any(Path(path).resolve() == output.resolve() for path in info.paths):
        raise LogError(f"{output}: is the log itself: name another output")
    first_ns = info.start_ns + round(start_s * 1e9)
    end_ns = None if duration_s is None else first_ns + round(duration_s * 1e9)
    times: list[int] = []
    if progress is not None:
        rest_s = max(info.duration_s - start_s, 0.0)
        wanted_s = rest_s if duration_s is None else min(rest_s, duration_s)
        progress.stage("convert", wanted_s, "s")
    with LogWriter(output, compression=compression, overwrite=overwrite) as writer:
        copier, messages, latched = Copier(writer), 0, 0
        for time_ns, topic, write in copier.writes(log, topics):
            if end_ns is not None and time_ns >= end_ns:
                break
            # Fixed transforms hold in the part that is wanted even where they came before it.
            if time_ns >= first_ns or topic.rstrip("/").endswith("tf_static"):
                latched += time_ns < first_ns
                times = [*times[:1], max(time_ns, first_ns)]
                write(times[-1])
                messages += 1
                if progress is not None:
                    progress.update(1e-9 * (times[-1] - times[0]))
        if messages == latched:
            raise LogError(
                f"nothing to write: no message of the selection in {', '.join(info.paths)}",
                problems=(*copier.losses(), *log.info().problems),
            )
    doubts = (doubt for topic, doubt in info.doubts if topic in (topics or known))
    losses = (*log.info().problems, *doubts, *copier.losses())
    return Conversion(messages, 1e-9 * (times[-1] - times[0]), losses)


class Copier:
    """Takes messages of any log to one writer."""

    def __init__(self, writer: LogWriter) -> None:
        self.writer = writer
        self._writing: dict[Channel, Callable[[int, bytes], None]] = {}
        self._lost = Counter[str]()

    def writes(
        self, log: LogSource, topics: frozenset[str] | None
    ) -> Iterator[tuple[int, str, Callable[[int], None]]]:
        """Log time, topic and the act of writing at a log time, message by message."""
        sources = log.sources if isinstance(log, MergedLog) else (log,)
        if all(isinstance(source, RecordedLog) for source in sources):
            assert isinstance(log, MergedLog | RecordedLog)
            for (time_ns, channel, data), moved in log.mended_records(topics):
                write = partial(self._copy, channel, data)
                yield time_ns, channel.topic, partial(self._encode, moved) if moved else write
            return
        for raw in log.messages(topics):
            yield raw.log_time_ns, raw.topic, partial(self._encode, raw)

    def losses(self) -> tuple[str, ...]:
        """What could not be read or written, for people."""
        return tuple(
            f"{reason}: {count} message(s) left out" for reason, count in sorted(self._lost.items())
        )

    def _copy(self, channel: Channel, data: bytes, log_time_ns: int) -> None:
        if channel not in self._writing:
            taken = writing_into(self.writer.sink, channel)
            self._writing[channel] = taken or partial(self._decoded, channel)
        try:
            self._writing[channel](log_time_ns, data)
        except LogError as error:
            self._lost[str(error)] += 1

    def _decoded(self, channel: Channel, log_time_ns: int, data: bytes) -> None:
        """A message whose encoding the output does not take, by way of our own types."""
        decoder = decoder_for(channel)
        if decoder.kind is MessageKind.OTHER:
            raise LogError(
                f"{channel.topic}: {channel.type_name} ({channel.encoding}) cannot be written as "
                f"{self.writer.sink.encoding}"
            )
        self.writer.write(channel.topic, decoder.message(data, log_time_ns).decode(), log_time_ns)

    def _encode(self, raw: RawMessage, log_time_ns: int) -> None:
        try:
            self.writer.write(raw.topic, raw.decode(), log_time_ns)
        except LogError as error:
            self._lost[str(error)] += 1
