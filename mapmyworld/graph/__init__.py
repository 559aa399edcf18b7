"""The pose graph: optimised, judged, explained. The only room that imports gtsam.

Its modules are imported one by one: to look at a graph takes none of what solves it.
"""
