"""Files in and files out, one format a file."""
