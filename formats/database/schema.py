"""The tables of a map: RTAB-Map's at version 0.20.0, and our own beside them.

RTAB-Map's columns carry what its tools need, in its precision. Ours (`mapmyworld_*`, which its
tools ignore) keep what they cannot: double precision, every tracked frame, rejected constraints.
"""

from __future__ import annotations

from collections.abc import Mapping

# The oldest version whose columns hold everything we write: the file then opens in every
# release since, and in distributions that ship 0.20 or 0.21.
RTABMAP_VERSION = "0.20.0"
# Of our own tables; a file with another number was written by another mapmyworld.
FORMAT = 5

_RTABMAP_TABLES: Mapping[str, str] = {
    "Node": "id INTEGER NOT NULL, map_id INTEGER NOT NULL, weight INTEGER, stamp FLOAT, pose BLOB,"
    " ground_truth_pose BLOB, velocity BLOB, label TEXT, gps BLOB, env_sensors BLOB,"
    " time_enter DATE, PRIMARY KEY (id)",
    "Data": "id INTEGER NOT NULL, image BLOB, depth BLOB, calibration BLOB, scan BLOB,"
    " scan_info BLOB, ground_cells BLOB, obstacle_cells BLOB, empty_cells BLOB, cell_size FLOAT,"
    " view_point_x FLOAT, view_point_y FLOAT, view_point_z FLOAT, user_data BLOB,"
    " time_enter DATE, PRIMARY KEY (id)",
    "Link": "from_id INTEGER NOT NULL, to_id INTEGER NOT NULL, type INTEGER NOT NULL,"
    " information_matrix BLOB NOT NULL, transform BLOB, user_data BLOB,"
    " FOREIGN KEY (from_id) REFERENCES Node(id), FOREIGN KEY (to_id) REFERENCES Node(id)",
    "Word": "id INTEGER NOT NULL, descriptor_size INTEGER NOT NULL, descriptor BLOB NOT NULL,"
    " time_enter DATE, PRIMARY KEY (id)",
    "Feature": "node_id INTEGER NOT NULL, word_id INTEGER NOT NULL, pos_x FLOAT NOT NULL,"
    " pos_y FLOAT NOT NULL, size INTEGER NOT NULL, dir FLOAT NOT NULL, response FLOAT NOT NULL,"
    " octave INTEGER NOT NULL, depth_x FLOAT, depth_y FLOAT, depth_z FLOAT,"
    " descriptor_size INTEGER, descriptor BLOB, FOREIGN KEY (node_id) REFERENCES Node(id)",
    "GlobalDescriptor": "node_id INTEGER NOT NULL, type INTEGER NOT NULL, info BLOB,"
    " data BLOB NOT NULL, FOREIGN KEY (node_id) REFERENCES Node(id)",
    "Info": "STM_size INTEGER, last_sign_added INTEGER, process_mem_used INTEGER,"
    " database_mem_used INTEGER, dictionary_size INTEGER, parameters TEXT, time_enter DATE",
    "Statistics": "id INTEGER NOT NULL, stamp FLOAT, data BLOB, wm_state BLOB,"
    " FOREIGN KEY (id) REFERENCES Node(id)",
    "Admin": "version TEXT, preview_image BLOB, opt_cloud BLOB, opt_ids BLOB, opt_poses BLOB,"
    " opt_last_localization BLOB, opt_polygons_size INTEGER, opt_polygons BLOB,"
    " opt_tex_coords BLOB, opt_tex_materials BLOB, opt_map BLOB, opt_map_x_min FLOAT,"
    " opt_map_y_min FLOAT, opt_map_resolution FLOAT, time_enter DATE",
}

_OWN_TABLES: Mapping[str, str] = {
    "mapmyworld_format": "version INTEGER NOT NULL",
    "mapmyworld_stages": "stage TEXT PRIMARY KEY, rank INTEGER NOT NULL, inputs TEXT NOT NULL",
    # `rank` is that of the stage which wrote the row; the highest one is in force.
    "mapmyworld_keys": "key TEXT NOT NULL, rank INTEGER NOT NULL, value TEXT NOT NULL,"
    " PRIMARY KEY (key, rank)",
    "mapmyworld_arrays": "name TEXT NOT NULL, rank INTEGER NOT NULL, dtype TEXT NOT NULL,"
    " shape TEXT NOT NULL, data BLOB NOT NULL, PRIMARY KEY (name, rank)",
    "mapmyworld_nodes": "id INTEGER PRIMARY KEY, session INTEGER NOT NULL,"
    " stamp_ns INTEGER NOT NULL, odom_from_base BLOB NOT NULL, tracked_from_base BLOB NOT NULL,"
    " weight INTEGER NOT NULL, ground_truth BLOB, scan_rest BLOB,"
    " image_stamps TEXT, cloud BLOB",
    "mapmyworld_features": "node_id INTEGER PRIMARY KEY, rank INTEGER NOT NULL",
    "mapmyworld_scans": "frame INTEGER PRIMARY KEY, scan BLOB NOT NULL",
    "mapmyworld_constraints": "id INTEGER PRIMARY KEY, rank INTEGER NOT NULL,"
    " from_id INTEGER NOT NULL, to_id INTEGER NOT NULL, kind TEXT NOT NULL,"
    " i_from_j BLOB NOT NULL, information BLOB NOT NULL, source TEXT NOT NULL,"
    " figures TEXT NOT NULL",
    # Of several verdicts on a constraint the last one counts.
    "mapmyworld_verdicts": "id INTEGER PRIMARY KEY, constraint_id INTEGER NOT NULL,"
    " rank INTEGER NOT NULL, judge TEXT NOT NULL, accepted INTEGER NOT NULL, why TEXT NOT NULL,"
    " numbers TEXT NOT NULL, note TEXT NOT NULL",
}

_INDEXES = (
    "CREATE UNIQUE INDEX IDX_Node_id ON Node (id)",
    "CREATE INDEX IDX_Feature_node_id ON Feature (node_id)",
    "CREATE INDEX IDX_GlobalDescriptor_node_id ON GlobalDescriptor (node_id)",
    "CREATE INDEX IDX_Link_from_id ON Link (from_id)",
    "CREATE UNIQUE INDEX IDX_node_label ON Node (label)",
    "CREATE UNIQUE INDEX IDX_Statistics_id ON Statistics (id)",
)


def _time_trigger(table: str, stamped: str) -> str:
    return (
        f"CREATE TRIGGER insert_{table}_timeEnter AFTER INSERT ON {table} BEGIN"
        f" UPDATE {stamped} SET time_enter = DATETIME('NOW') WHERE rowid = new.rowid; END"
    )


TRIGGERS = (
    "CREATE TRIGGER insert_Feature BEFORE INSERT ON Feature"
    " WHEN NOT EXISTS (SELECT Node.id FROM Node WHERE Node.id = NEW.node_id)"
    " BEGIN SELECT RAISE(ABORT, 'Foreign key constraint failed in Feature table'); END",
    _time_trigger("Node", "Node"),
    _time_trigger("Data", "Node"),  # sic: RTAB-Map stamps the node when its data arrive
    _time_trigger("Word", "Word"),
    _time_trigger("Info", "Info"),
)


TABLES = frozenset({*_RTABMAP_TABLES, *_OWN_TABLES})


def statements() -> tuple[str, ...]:
    """The SQL that makes an empty map's tables, indexes and triggers."""
    tables = {**_RTABMAP_TABLES, **_OWN_TABLES}
    creates = tuple(f"CREATE TABLE {name} ({columns})" for name, columns in tables.items())
    return creates + _INDEXES + TRIGGERS
