"""A pose in a finished map."""
