"""The pose graph and its optimisation."""
