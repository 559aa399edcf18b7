"""Maps from poses."""
