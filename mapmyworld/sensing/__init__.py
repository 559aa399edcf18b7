"""Messages become frames."""
