"""Pictures and pages about a map."""
