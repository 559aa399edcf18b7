from formats.database import open_store as open_map
from formats.logs import open_log

__all__ = ["open_log", "open_map"]
