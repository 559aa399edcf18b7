"""map.db: SQLite in RTAB-Map's schema with our own tables beside."""
