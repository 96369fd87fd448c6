"""A rendered town, so that a fresh machine runs every study with no download.

Everything follows from the fields of :class:`CityTraversal`. An image is made in these steps, each from the results of
the ones before it:

1. *Town* (``town``): a plan of streets and a railway (``streets``), lots with houses (``lots``, ``buildings``), the
   country around them (``country``), trees, lamps and furniture (``furnish``, ``trees``, and ``models`` built of
   ``solids``); then grids that tell compiled code what is near a point (``grids``).
2. *Pose* (``traversal``): a route (``routes``), the deviations of a real drive, a camera (``view``).
3. *Trace* (``rendering``, ``trace``): for each of four samples per pixel, which surface it sees and how far away, with the
   cars and people met (``traffic``). Buildings are prisms, so one ray in the plane per column of samples finds walls and
   roofs.
4. *Paint* (``fragments``, ``ground``, ``facade``, ``surfaces``): what each surface in each pixel looks like, from hashes
   and smooth noise (``noise``) filtered to the pixel's size, in the colours of ``palette``.
5. *Light* (``conditions``, ``lighting``): sun with cast shadows, sky, street lamps, headlights, haze; then branches,
   poles and people (``rods``).
6. *Develop* (``develop``): mirror images, halos, exposure, tone and noise, as the condition's sensor renders them.
7. *Write* (``rendering``): JPEG files and positions, whole or not at all.

The same traversal gives the same bytes, in any order and with any number of workers. Processors of another kind may
round differently: single values of pixels can then differ by one.

The inner loops are compiled on first use (``kernel``), or by ``python -m artifact_city`` beforehand, and the machine code
is kept on disk.
"""

from artifact_city.conditions import CONDITIONS
from artifact_city.rendering import compile_all, render, render_frame
from artifact_city.traversal import CityTraversal, positions
from artifact_city.view import CAMERAS

CITY_REVISION = 2  # raise when any pixel or position changes: part of cache keys

__all__ = [
    "CAMERAS",
    "CITY_REVISION",
    "CONDITIONS",
    "CityTraversal",
    "compile_all",
    "positions",
    "render",
    "render_frame",
]
