"""Conditions: sun, sky, weather, season, night, and how the camera's sensor renders them."""

from dataclasses import dataclass, replace

import numpy as np

from artifact_city.records import RGB as RGB_FIELD
from artifact_city.records import layout, record

RGB = tuple[float, float, float]


@dataclass(frozen=True)
class Condition:
    """The look of the world at one time, and of the sensor that sees it. Colours are linear light.

    Attributes
    ----------
    sun_azimuth, sun_elevation : float
        Degrees, anticlockwise from east, and above the horizon.
    sun : RGB
        Irradiance on a surface that faces the sun.
    sky_top, sky_low : RGB
        Radiance of the clear sky overhead and at the horizon.
    cloud, cloud_shade : RGB
        Radiance of the bright and the dark parts of clouds.
    cloudiness : float
        Share of the sky under cloud.
    ambient : float
        Strength of the sky's light on surfaces.
    haze : float
        Extinction per metre.
    dark : float
        1 at night: lamps, lit windows and headlights are on.
    lit : float
        Share of windows lit.
    wet, rain, snow : float
        Water and snow on surfaces, and rain in the air, each from 0 to 1.
    foliage : float
        Leaves on the trees: 0 bare, 1 full.
    leaf, grass : RGB
        Tints of leaves and grass.
    exposure, contrast, saturation : float
        Of the developed image.
    warmth : float
        White balance; above 1 is warm.
    noise, blur : float
        Sensor noise (standard deviation, share of white) and blur (pixels).
    tint : RGB or None
        Monochrome images in this tint.
    vignette, scratches : float
        Dark corners and damage of an old plate, each from 0 to 1.
    era : {"today", "past"}
        Which town.
    """

    name: str
    sun_azimuth: float = 215.0
    sun_elevation: float = 48.0
    sun: RGB = (2.7, 2.45, 2.1)
    sky_top: RGB = (0.16, 0.33, 0.72)
    sky_low: RGB = (0.62, 0.76, 0.95)
    cloud: RGB = (1.15, 1.12, 1.08)
    cloud_shade: RGB = (0.62, 0.66, 0.74)
    cloudiness: float = 0.38
    ambient: float = 1.0
    haze: float = 0.0011
    dark: float = 0.0
    lit: float = 0.0
    wet: float = 0.0
    rain: float = 0.0
    snow: float = 0.0
    foliage: float = 1.0
    leaf: RGB = (1.0, 1.0, 1.0)
    grass: RGB = (1.0, 1.0, 1.0)
    exposure: float = 0.95
    contrast: float = 1.0
    saturation: float = 1.05
    warmth: float = 1.0
    noise: float = 0.006
    blur: float = 0.0
    tint: RGB | None = None
    vignette: float = 0.08
    scratches: float = 0.0
    era: str = "today"


_SUN = Condition("sun")
_OVERCAST = replace(
    _SUN,
    name="overcast",
    sun=(0.05, 0.05, 0.05),
    sky_top=(0.62, 0.66, 0.72),
    sky_low=(0.86, 0.88, 0.9),
    cloud=(0.95, 0.97, 1.0),
    cloud_shade=(0.55, 0.58, 0.63),
    cloudiness=1.0,
    ambient=1.35,
    haze=0.0022,
    exposure=0.92,
    saturation=0.88,
)
_NIGHT = replace(
    _SUN,
    name="night",
    sun=(0.0, 0.0, 0.0),
    sky_top=(0.012, 0.018, 0.036),
    sky_low=(0.066, 0.054, 0.050),
    cloud=(0.054, 0.045, 0.043),
    cloud_shade=(0.020, 0.021, 0.027),
    cloudiness=0.5,
    ambient=4.2,
    haze=0.0016,
    dark=1.0,
    lit=0.3,
    exposure=2.0,
    saturation=0.95,
    noise=0.014,
    blur=0.3,
    vignette=0.2,
)

CONDITIONS = {
    c.name: c
    for c in (
        _SUN,
        _OVERCAST,
        replace(
            _OVERCAST,
            name="rain",
            sky_top=(0.40, 0.43, 0.48),
            sky_low=(0.58, 0.6, 0.62),
            cloud=(0.6, 0.62, 0.66),
            cloud_shade=(0.34, 0.36, 0.4),
            ambient=1.25,
            haze=0.004,
            lit=0.16,
            wet=1.0,
            rain=0.85,
            exposure=1.2,
            contrast=0.97,
            saturation=0.85,
            noise=0.007,
            blur=0.15,
        ),
        _NIGHT,
        replace(
            _NIGHT,
            name="night_grey",
            noise=0.025,
            exposure=2.6,
            tint=(1.0, 1.0, 1.0),
            lit=0.2,
            blur=0.45,
            contrast=1.06,
        ),
        replace(
            _OVERCAST,
            name="winter",
            sky_top=(0.42, 0.48, 0.57),
            sky_low=(0.70, 0.73, 0.77),
            cloud=(0.82, 0.84, 0.88),
            cloud_shade=(0.44, 0.48, 0.55),
            ambient=1.1,
            haze=0.0016,
            snow=0.52,
            foliage=0.0,
            grass=(1.2, 0.8, 0.8),
            saturation=0.8,
            warmth=0.95,
        ),
        replace(
            _SUN,
            name="summer",
            sun_elevation=58.0,
            sky_top=(0.11, 0.29, 0.74),
            cloudiness=0.22,
            leaf=(0.9, 1.08, 0.85),
            grass=(1.0, 1.02, 0.95),
            saturation=1.08,
        ),
        replace(
            _SUN,
            name="morning",
            sun_azimuth=28.0,
            sun_elevation=21.0,
            sun=(2.7, 2.05, 1.35),
            sky_top=(0.2, 0.36, 0.68),
            sky_low=(0.85, 0.8, 0.74),
            cloudiness=0.2,
            ambient=0.9,
            haze=0.0022,
            warmth=1.04,
        ),
        replace(
            _SUN,
            name="afternoon",
            sun_azimuth=172.0,
            sun_elevation=26.0,
            sun=(2.8, 2.15, 1.4),
            sky_top=(0.17, 0.33, 0.7),
            sky_low=(0.8, 0.8, 0.8),
            cloudiness=0.45,
            ambient=0.9,
            warmth=1.03,
        ),
        replace(
            _SUN,
            name="historical",
            sun_azimuth=140.0,
            sun_elevation=40.0,
            sun=(0.8, 0.77, 0.7),
            sky_top=(0.75, 0.8, 0.9),
            sky_low=(0.95, 0.95, 0.95),
            cloudiness=0.9,
            ambient=1.15,
            haze=0.0018,
            exposure=0.78,
            contrast=1.18,
            noise=0.013,
            blur=0.35,
            tint=(1.0, 0.93, 0.8),
            vignette=0.3,
            scratches=0.55,
            foliage=1.0,
            era="past",
        ),
        replace(
            _SUN,
            name="street_view",
            sun_azimuth=255.0,
            sun_elevation=62.0,
            sun=(2.5, 2.35, 2.1),
            sky_top=(0.3, 0.48, 0.82),
            sky_low=(0.85, 0.9, 0.98),
            cloudiness=0.28,
            haze=0.0018,
            exposure=1.02,
            contrast=0.95,
            saturation=1.2,
            leaf=(1.05, 1.0, 0.85),
        ),
    )
}


# What compiled code needs of a condition, with what differs between two traversals in the same condition.
LIGHT = layout(
    sun_x="f8",
    sun_y="f8",
    sun_z="f8",
    sun=RGB_FIELD,
    sky_top=RGB_FIELD,
    sky_low=RGB_FIELD,
    cloud=RGB_FIELD,
    cloud_shade=RGB_FIELD,
    cloudiness="f8",
    cloud_seed="f8",
    above=RGB_FIELD,  # light from the sky on a surface that faces up
    below=RGB_FIELD,  # light from the ground on a surface that faces down
    haze="f8",
    haze_colour=RGB_FIELD,
    dark="f8",
    lit="f8",
    lit_seed="f8",
    beams="f8",  # the camera car's own headlights
    wet="f8",
    snow="f8",
    foliage="f8",
    leaf=RGB_FIELD,
    grass=RGB_FIELD,
    past="i8",
)


def make_light(condition: Condition, seed: int, *, beams: bool) -> np.ndarray:
    """Derive the light of one traversal, as one record ``LIGHT``.

    ``seed`` moves the clouds and decides which windows are lit; ``beams`` switches on the camera's own headlights.
    """
    c = condition
    azimuth, elevation = np.radians(c.sun_azimuth), np.radians(c.sun_elevation)
    top, low, cloud = (np.array(v) for v in (c.sky_top, c.sky_low, c.cloud))
    clear = 0.6 * top + 0.4 * low
    above = c.ambient * ((1 - 0.6 * c.cloudiness) * clear + 0.6 * c.cloudiness * cloud)
    albedo = 0.2 + 0.45 * c.snow
    derived = {
        "sun_x": np.cos(elevation) * np.cos(azimuth),
        "sun_y": np.cos(elevation) * np.sin(azimuth),
        "sun_z": np.sin(elevation),
        "cloud_seed": seed % 100_000,
        "above": above,
        "below": albedo * (above + 0.6 * np.array(c.sun) * np.sin(elevation)),
        "haze_colour": 0.75 * low + 0.25 * clear,
        "lit_seed": seed % 100_000 + 17,
        "beams": c.dark if beams else 0.0,
        "past": c.era == "past",
    }
    return record(LIGHT, {**{name: getattr(c, name) for name in LIGHT.names if name not in derived}, **derived})
