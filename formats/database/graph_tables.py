"""The constraints and the visual words of a map of ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import NDArray

from formats.database import feature_rows, links
from formats.database.connection import Connection
from formats.database.transactions import Transactions
from mapmyworld.types import Judged, Verdict


class GraphTables(Transactions):
    """Every constraint with its verdicts, and RTAB-Map's links of the accepted ones."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(connection)
        self._known: dict[int, Judged] | None = None

    def add_constraints(self, constraints: Sequence[Judged]) -> None:
        self._begin()
        (first,) = self._db.row("SELECT COALESCE(MAX(id), 0) + 1 FROM mapmyworld_constraints")
        made = dict(enumerate(constraints, first))
        if self._known is not None:
            self._known |= made
        rank = self._current_rank()
        rows = [(number, rank, c) for number, c in made.items()]
        self._db.run_many(links.INSERT_CONSTRAINT, links.constraint_rows(rows))
        self._add_verdicts(
            [(number, verdict) for number, c in made.items() for verdict in c.verdicts]
        )
        self._db.run_many(links.INSERT_LINK, links.link_rows(constraints))
        self._commit()

    def judge(self, constraints: Sequence[Judged]) -> None:
        self._begin()
        known = self._in_force()
        judged = dict(zip(known, constraints[: len(known)], strict=True))
        self._add_verdicts(
            [
                (k, verdict)
                for k, c in judged.items()
                for verdict in c.verdicts[len(known[k].verdicts) :]
            ]
        )
        self._known = {k: c for k, c in judged.items() if not c.is_superseded}
        self.add_constraints(constraints[len(known) :])
        self._rewrite_links()
        self._commit()

    def constraints(self) -> tuple[Judged, ...]:
        return tuple(self._in_force().values())

    def _add_verdicts(self, numbered: Sequence[tuple[int, Verdict]]) -> None:
        rank = self._current_rank()
        rows = [(number, rank, verdict) for number, verdict in numbered]
        self._db.run_many(links.INSERT_VERDICT, links.verdict_rows(rows))

    def _in_force(self) -> dict[int, Judged]:
        """Id -> constraint, of those that no better measurement took the place of."""
        if self._known is None:
            verdicts = links.verdicts_from_rows(self._db.rows(links.SELECT_VERDICTS))
            self._known = {
                row[-1]: c
                for row in self._db.iterate(links.SELECT_CONSTRAINTS)
                if not (c := links.constraint_from_row(row, verdicts)).is_superseded
            }
        return self._known

    def _forget_constraints(self) -> None:
        """What is known of them, for an earlier stage is done again."""
        self._known = None
        self._rewrite_links()

    def _rewrite_links(self) -> None:
        self._db.run("DELETE FROM Link")
        self._db.run_many(links.INSERT_LINK, links.link_rows(self.constraints()))

    def set_words(self, words: Mapping[int, NDArray[Any]]) -> None:
        self._begin()
        self._db.run("DELETE FROM Word")
        rows = ((k, words[k].size, words[k].tobytes()) for k in sorted(words))
        self._db.run_many(feature_rows.INSERT_WORD, rows)
        self._db.run("UPDATE Info SET dictionary_size = ?", (len(words),))
        self._commit()

    def words(self) -> dict[int, NDArray[Any]]:
        return feature_rows.read_words(self._db)
