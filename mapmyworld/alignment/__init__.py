"""All scans of a map aligned with each other, from the poses of the solved graph.

Its factors are the back end's, and hold with everything else that is known of the poses.
"""
