"""
A rendered town, so that a fresh machine runs every study with no download.

A town is a plan of streets with houses, trees, lamps and a railway around it (:mod:`town`); a traversal drives or walks
a route through it under one condition (:mod:`traversal`); an image is ray-cast column by column, painted, lit and
developed (:mod:`frame`). Everything follows from the fields of :class:`CityTraversal`: the same traversal gives the
same bytes, in any order and with any number of workers.
"""

from .conditions import CONDITIONS
from .traversal import CityTraversal, positions, render_frame, visible_buildings
from .view import CAMERAS
from .writer import render

CITY_REVISION = 1  # raise when any pixel or position changes: part of cache keys

__all__ = [
    "CAMERAS",
    "CITY_REVISION",
    "CONDITIONS",
    "CityTraversal",
    "positions",
    "render",
    "render_frame",
    "visible_buildings",
]
