"""The constraints and the visual words of a map of ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import NDArray

from formats.database import features as feature_rows
from formats.database import links
from formats.database.connection import Connection
from formats.database.stages import REPLACED
from formats.database.transactions import Transactions
from mapmyworld.types import Constraint


class GraphTables(Transactions):
    """Every constraint with its verdict, and RTAB-Map's links of the accepted ones."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(connection)
        self._constraints: tuple[Constraint, ...] | None = None
        self._solved_anew = False

    def add_constraints(self, constraints: Sequence[Constraint]) -> None:
        self._begin()
        if self._constraints is not None:
            self._constraints += tuple(constraints)
        ranked = [(constraint, self._current_rank()) for constraint in constraints]
        self._db.later(links.INSERT_CONSTRAINT, ranked, links.constraint_rows)
        self._db.later(links.INSERT_LINK, constraints, links.link_rows)
        self._settle()

    def replace_constraints(self, constraints: Sequence[Constraint]) -> None:
        self._begin()
        rank = self._current_rank()
        # Those of earlier stages stay, out of sight, for when this stage is done again.
        self._db.run("DELETE FROM mapmyworld_constraints WHERE rank >= ?", (rank,))
        ranked = [(constraint, rank) for constraint in constraints]
        self._db.run_many(links.INSERT_CONSTRAINT, links.constraint_rows(ranked))
        mark = "INSERT OR REPLACE INTO mapmyworld_keys VALUES (?,?,'true')"
        self._db.run(mark, (REPLACED, rank))
        self._constraints = tuple(constraints)
        self._rewrite_links()
        self._solved_anew = True
        self._settle()

    def constraints(self) -> tuple[Constraint, ...]:
        if self._constraints is None:
            newest = "SELECT MAX(rank) FROM mapmyworld_keys WHERE key = ?"
            (rank,) = self._db.row(newest, (REPLACED,))
            first = -1 if rank is None else rank
            found = self._db.in_chunks(links.SELECT_CONSTRAINTS, (first,))
            self._constraints = tuple(
                c for some in found for c in links.constraints_from_rows(some)
            )
        return self._constraints

    def _rewrite_links(self) -> None:
        self._db.run("DELETE FROM Link")
        self._db.run_many(links.INSERT_LINK, links.link_rows(self.constraints()))

    def set_words(self, words: Mapping[int, NDArray[Any]]) -> None:
        self._begin()
        self._db.run("DELETE FROM Word")
        self._db.run_many(feature_rows.INSERT_WORD, feature_rows.word_rows(words))
        self._db.run("UPDATE Info SET dictionary_size = ?", (len(words),))
        self._settle()

    def words(self) -> dict[int, NDArray[Any]]:
        return feature_rows.read_words(self._db)
