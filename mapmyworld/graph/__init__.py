"""The pose graph: optimised, judged, explained. What solves it is `mapmyworld.backend`.

Its modules are imported one by one: to look at a graph takes none of what solves it.
"""
