"""Grid-based FastSLAM."""
