"""Sizes of the places that robots with two-dimensional lidars drive in, from which limits of all packages follow.

A limit that means one of these sizes is computed from it, so that it is stated once and for one reason.
"""

from __future__ import annotations

# Metres within which points and lines may belong to one surface: noise of lidars, errors of poses nearby, and the depth
# of frames. Walls and furniture are thicker, and gaps between them wider.
# Origin: chosen, several times the noise of usual lidars; not measured.
SURFACE_DEPTH = 0.1
# Metres, width of a door: the usual interruption of a wall, and the size of a piece of furniture.
# Origin: chosen, doors measure 0.8 to 1.2 m.
DOOR_WIDTH = 1.0
# Metres of a wall that determine its line, and from which on two walls are compared. Origin: chosen; not measured.
MIN_WALL_LENGTH = 0.5
# Metres, side of a room. What is seen from places this far apart is hardly the same. Origin: chosen, an office for some
# people; not measured.
ROOM_SIZE = 6.0
# Metres that scans reach indoors, where walls usually end them before the lidar's range does.
# Origin: chosen, two rooms; not measured.
INDOOR_RANGE = 2.0 * ROOM_SIZE
# Metres of driving over which errors of odometry are common, and small enough to tell places: the length of a corridor.
# Origin: chosen; not measured.
CORRIDOR_LENGTH = 20.0
# Metres that no building exceeds. Origin: chosen; not measured.
BUILDING_SIZE = 1000.0
