"""What numbers in files may be: beyond it they are damage, and squares of them overflow."""

FARTHEST = 1e9  # m, pixels or degrees, beyond which nothing lies
LARGEST = 1e100  # of what has no such unit: squares and products of such numbers are finite
LATEST_NS = (1 << 62) - 1  # the year 2116, beyond what ROS can stamp
