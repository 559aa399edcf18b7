"""What each stage of a build wrote, so that doing one again clears it and all that follows."""

from __future__ import annotations

from formats.database.connection import Connection
from mapmyworld.errors import MapError
from mapmyworld.types.seams import STAGE_RANKS

_TRACK, _RECOGNISE, _OPTIMISE = (STAGE_RANKS[name] for name in ("track", "recognise", "optimise"))
_NODE_TABLES = (
    "GlobalDescriptor",
    "Feature",
    "Data",
    "Node",
    "mapmyworld_nodes",
    "mapmyworld_scans",
)


def rank_of(stage: str) -> int:
    """The stage's place in the order of the build; raises `MapError` for an unknown one."""
    if stage not in STAGE_RANKS:
        raise MapError(f"no stage is called {stage!r}: there are {', '.join(STAGE_RANKS)}")
    return STAGE_RANKS[stage]


def clear_from(db: Connection, rank: int) -> bool:
    """Deletes what stages of this rank and later wrote.

    Returns whether constraints were among it: Link rows are the caller's to write again.
    """
    judged = db.row(
        "SELECT EXISTS (SELECT 1 FROM mapmyworld_constraints WHERE rank >= ?)"
        " OR EXISTS (SELECT 1 FROM mapmyworld_verdicts WHERE rank >= ?)",
        (rank, rank),
    )
    for table in ("stages", "keys", "arrays", "constraints", "verdicts"):
        db.run(f"DELETE FROM mapmyworld_{table} WHERE rank >= ?", (rank,))
    if rank <= _TRACK:
        for table in _NODE_TABLES:
            db.run(f"DELETE FROM {table}")
    if rank <= _RECOGNISE:
        _clear_words(db, rank)
    if rank <= _OPTIMISE:
        db.run("UPDATE Admin SET opt_ids = NULL, opt_poses = NULL, opt_last_localization = NULL")
    db.run(
        "UPDATE Admin SET opt_map = NULL, opt_map_x_min = NULL, opt_map_y_min = NULL,"
        " opt_map_resolution = NULL"
    )
    return bool(judged[0])


def _clear_words(db: Connection, rank: int) -> None:
    """Features that were there before lose their words, the rest go."""
    db.run("DELETE FROM Word")
    later = "(SELECT node_id FROM mapmyworld_features WHERE rank >= ?)"
    db.run(f"DELETE FROM Feature WHERE node_id IN {later}", (rank,))
    db.run("UPDATE Feature SET word_id = -rowid WHERE word_id > 0")
    db.run("DELETE FROM mapmyworld_features WHERE rank >= ?", (rank,))
    db.run("UPDATE Info SET dictionary_size = 0")
