"""Many logs: the manifest that names them, one job for each, who runs the jobs, the summary."""
