"""The back end: constraints in bulk as one factor graph, which gtsam solves. The only package
that imports gtsam.

`system` holds the arrays, `factors` makes gtsam's factors of them, `descent` solves, `information`
indicates how certain the solution is, `certificate` whether there can be a better one.
"""
