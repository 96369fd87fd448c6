"""A whole town: plan, buildings, trees, lamps and furniture, with the grids that make rendering fast."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import zoom

from artifact_city import grids
from artifact_city.buildings import Building, as_records, historical
from artifact_city.country import country_buildings
from artifact_city.furnish import Furniture, furnish, park_paths
from artifact_city.grids import HEIGHT_CELL, Extent
from artifact_city.kernel import layout, record
from artifact_city.lots import Site, Zone, build_sites, canal_walls
from artifact_city.streets import MARGIN, Plan, inset, make_plan, railway, street_pieces
from artifact_city.trees import tree_shapes

LAMP_REACH = 24.0  # metres

WORLD = layout("west south seed")
LAMP = layout("x y z power tone")


class Scene(NamedTuple):
    """Everything of a town that compiled code reads: records, and tables of what is near each cell of a grid."""

    world: np.ndarray  # one record WORLD
    streets: np.ndarray  # STREET_PIECE
    buildings: np.ndarray  # PRISM
    trees: np.ndarray  # TREE
    lamps: np.ndarray  # LAMP
    street_table: np.ndarray  # items near each cell, int32 (rows, columns, most), padded with -1
    building_table: np.ndarray
    lamp_table: np.ndarray
    zone: np.ndarray  # kind of yard, uint8, one cell per metre
    roof_height: np.ndarray  # of buildings, float32, two cells per metre
    crown_height: np.ndarray
    openness: np.ndarray  # share of the sky seen from the ground, float32, a cell per two metres


@dataclass(frozen=True)
class Town:
    """A town in one era."""

    plan: Plan
    track: np.ndarray
    sites: tuple[Site, ...]
    buildings: tuple[Building, ...]
    furniture: Furniture
    scene: Scene


def extent_of(plan: Plan) -> Extent:
    """Return the land that a town covers."""
    flat = plan.junctions.reshape(-1, 2)
    low, high = flat.min(axis=0) - MARGIN, flat.max(axis=0) + MARGIN
    return Extent(float(low[0]), float(low[1]), float(high[0] - low[0]), float(high[1] - low[1]))


@lru_cache(maxsize=4)
def make_town(seed: int, era: str = "today") -> Town:
    """Build town ``seed`` as it is ``today`` or was in the ``past``; about a second, kept for the last few towns.

    In the past shops differ, the modern houses and some others are not yet built, and streets have older furniture.
    """
    plan = make_plan(seed)
    track = railway(plan, 6.0)
    sites = build_sites(plan)
    paths = [path for site in sites if site.zone == Zone.PARK for path in park_paths(site)]
    buildings = [b for site in sites for b in site.buildings] + canal_walls(plan) + country_buildings(plan, track)
    if era == "past":
        buildings = historical(np.random.default_rng([seed, 11]), buildings, share=0.06)
    prisms = as_records(buildings)
    furniture = furnish(plan, sites, buildings, prisms, track, era)
    scene = _scene(plan, street_pieces(plan, track, paths), prisms, sites, furniture)
    return Town(plan, track, tuple(sites), tuple(buildings), furniture, scene)


def _scene(plan: Plan, streets: np.ndarray, buildings: np.ndarray, sites: list[Site], furniture: Furniture) -> Scene:
    extent = extent_of(plan)
    corner, shape = (extent.west, extent.south), extent.shape(HEIGHT_CELL)
    roofs = grids.raise_buildings(buildings, *corner, *shape)
    shapes = tree_shapes()
    # Ground under a yard's edge may be asked for just outside its block, hence the outset.
    zones = [(inset(site.block.corners, (-1.0,) * 4), int(site.zone)) for site in sites]
    return Scene(
        world=record(WORLD, {"west": extent.west, "south": extent.south, "seed": plan.seed}),
        streets=streets,
        buildings=buildings,
        trees=furniture.trees,
        lamps=np.array([tuple(lamp) for lamp in furniture.lamps], dtype=LAMP),
        street_table=grids.street_table(streets, 2.0, extent, grids.STREET_CELL),
        building_table=grids.polygon_table(buildings["corners"], extent, grids.BUILDING_CELL),
        lamp_table=grids.lamp_table(furniture.lamps[:, :2], LAMP_REACH, extent, grids.LAMP_CELL),
        zone=grids.zone_map(zones, extent),
        roof_height=roofs,
        crown_height=grids.raise_trees(furniture.trees, shapes.shapes, shapes.blobs, *corner, *shape),
        openness=grids.sky_seen(roofs),
    )


@lru_cache(maxsize=3)
def shade_map(seed: int, era: str, azimuth: float, elevation: float) -> np.ndarray:
    """Shadow heights of roofs and crowns and the share of sky seen, float32 (rows, columns, 3), for a sun in degrees.

    The last few maps are kept: every frame of a traversal needs the same one.
    """
    scene = make_town(seed, era).scene
    shade = np.empty((*scene.roof_height.shape, 3), dtype=np.float32)
    seen = zoom(scene.openness, round(grids.OPEN_CELL / HEIGHT_CELL), order=1, mode="nearest", grid_mode=True)
    shade[..., 2] = seen[: shade.shape[0], : shade.shape[1]]
    for layer, heights in enumerate((scene.roof_height, scene.crown_height)):
        shadow = np.zeros_like(heights)
        grids.cast_shadows(heights, np.radians(azimuth), np.radians(elevation), shadow)
        shade[..., layer] = shadow
    return shade
