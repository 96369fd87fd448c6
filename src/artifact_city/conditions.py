"""Conditions: sun, sky, weather, season, night, and how the camera's sensor renders them. Colours are linear light."""

from dataclasses import dataclass, replace

import numpy as np

from artifact_city.kernel import layout, record

RGB = tuple[float, float, float]


@dataclass(frozen=True)
class Sun:
    """Direction in degrees (anticlockwise from east, above the horizon), and irradiance on a surface that faces it."""

    azimuth: float = 215.0
    elevation: float = 48.0
    light: RGB = (2.7, 2.45, 2.1)


@dataclass(frozen=True)
class Sky:
    """Radiance of the clear sky overhead and at the horizon, of bright and dark parts of clouds; share under cloud."""

    top: RGB = (0.16, 0.33, 0.72)
    low: RGB = (0.62, 0.76, 0.95)
    cloud: RGB = (1.15, 1.12, 1.08)
    shade: RGB = (0.62, 0.66, 0.74)
    cloudiness: float = 0.38


@dataclass(frozen=True)
class Sensor:
    """Development of the image.

    ``warmth`` above 1 is warm; ``noise`` is a standard deviation as share of white, ``blur`` one in pixels; ``tint`` makes
    images monochrome; ``vignette`` darkens corners, from 0 to 1.
    """

    exposure: float = 0.95
    contrast: float = 1.0
    saturation: float = 1.05
    warmth: float = 1.0
    noise: float = 0.006
    blur: float = 0.0
    tint: RGB | None = None
    vignette: float = 0.08


@dataclass(frozen=True)
class Condition:
    """The look of the world at one time, and of the sensor that sees it."""

    sun: Sun = Sun()
    sky: Sky = Sky()
    sensor: Sensor = Sensor()
    ambient: float = 1.0  # strength of the sky's light on surfaces
    haze: float = 0.0011  # extinction per metre
    dark: float = 0.0  # 1 at night: lamps, lit windows and headlights are on
    lit: float = 0.0  # share of windows lit
    wet: float = 0.0  # water on surfaces, 0 to 1
    snow: float = 0.0  # on surfaces, 0 to 1
    foliage: float = 1.0  # 0 bare, 1 full
    leaf: RGB = (1.0, 1.0, 1.0)  # tints
    grass: RGB = (1.0, 1.0, 1.0)
    era: str = "today"  # or "past"


_OVERCAST = Condition(
    Sun(light=(0.05, 0.05, 0.05)),
    Sky((0.62, 0.66, 0.72), (0.86, 0.88, 0.9), (0.95, 0.97, 1.0), (0.55, 0.58, 0.63), 1.0),
    Sensor(exposure=0.92, saturation=0.88),
    ambient=1.35,
    haze=0.0022,
)
_NIGHT = Condition(
    Sun(light=(0.0, 0.0, 0.0)),
    Sky((0.012, 0.018, 0.036), (0.066, 0.054, 0.050), (0.054, 0.045, 0.043), (0.020, 0.021, 0.027), 0.5),
    Sensor(exposure=2.0, saturation=0.95, noise=0.014, blur=0.3, vignette=0.2),
    ambient=4.2,
    haze=0.0016,
    dark=1.0,
    lit=0.3,
)

CONDITIONS = {
    "sun": Condition(),
    "overcast": _OVERCAST,
    "rain": replace(
        _OVERCAST,
        sky=Sky((0.40, 0.43, 0.48), (0.58, 0.6, 0.62), (0.6, 0.62, 0.66), (0.34, 0.36, 0.4), 1.0),
        sensor=Sensor(exposure=1.2, contrast=0.97, saturation=0.85, noise=0.007, blur=0.15),
        ambient=1.25,
        haze=0.004,
        lit=0.16,
        wet=1.0,
    ),
    "night": _NIGHT,
    "night_grey": replace(
        _NIGHT,
        sensor=Sensor(2.6, contrast=1.06, noise=0.025, blur=0.45, tint=(1.0, 1.0, 1.0), vignette=0.2),
        lit=0.2,
    ),
    "winter": replace(
        _OVERCAST,
        sky=Sky((0.42, 0.48, 0.57), (0.70, 0.73, 0.77), (0.82, 0.84, 0.88), (0.44, 0.48, 0.55), 1.0),
        sensor=Sensor(exposure=0.92, saturation=0.8, warmth=0.95),
        ambient=1.1,
        haze=0.0016,
        snow=0.52,
        foliage=0.0,
        grass=(1.2, 0.8, 0.8),
    ),
    "summer": Condition(
        Sun(elevation=58.0),
        Sky(top=(0.11, 0.29, 0.74), cloudiness=0.22),
        Sensor(saturation=1.08),
        leaf=(0.9, 1.08, 0.85),
        grass=(1.0, 1.02, 0.95),
    ),
    "morning": Condition(
        Sun(28.0, 21.0, (2.7, 2.05, 1.35)),
        Sky(top=(0.2, 0.36, 0.68), low=(0.85, 0.8, 0.74), cloudiness=0.2),
        Sensor(warmth=1.04),
        ambient=0.9,
        haze=0.0022,
    ),
    "afternoon": Condition(
        Sun(172.0, 26.0, (2.8, 2.15, 1.4)),
        Sky(top=(0.17, 0.33, 0.7), low=(0.8, 0.8, 0.8), cloudiness=0.45),
        Sensor(warmth=1.03),
        ambient=0.9,
    ),
    "historical": Condition(
        Sun(140.0, 40.0, (0.8, 0.77, 0.7)),
        Sky(top=(0.75, 0.8, 0.9), low=(0.95, 0.95, 0.95), cloudiness=0.9),
        Sensor(0.78, contrast=1.18, noise=0.013, blur=0.35, tint=(1.0, 0.93, 0.8), vignette=0.3),
        ambient=1.15,
        haze=0.0018,
        era="past",
    ),
    "street_view": Condition(
        Sun(255.0, 62.0, (2.5, 2.35, 2.1)),
        Sky(top=(0.3, 0.48, 0.82), low=(0.85, 0.9, 0.98), cloudiness=0.28),
        Sensor(exposure=1.02, contrast=0.95, saturation=1.2),
        haze=0.0018,
        leaf=(1.05, 1.0, 0.85),
    ),
}

# What compiled code needs of a condition, with what differs between two traversals in the same one. ``above`` is the light
# from the sky on a surface that faces up, ``below`` that from the ground on one that faces down; ``beams`` are the camera
# car's own headlights.
LIGHT = layout(
    "sun_x sun_y sun_z sun:3 sky_top:3 sky_low:3 cloud:3 cloud_shade:3 cloudiness cloud_seed above:3 below:3 haze "
    "haze_colour:3 dark lit lit_seed beams wet snow foliage leaf:3 grass:3 past:i"
)


def make_light(condition: Condition, seed: int, *, beams: bool) -> np.ndarray:
    """Derive the light of one traversal, as one record ``LIGHT``.

    ``seed`` moves the clouds and decides which windows are lit; ``beams`` switches on the camera's own headlights.
    """
    c, sky = condition, condition.sky
    azimuth, elevation = np.radians(c.sun.azimuth), np.radians(c.sun.elevation)
    clear = 0.6 * np.array(sky.top) + 0.4 * np.array(sky.low)
    above = c.ambient * ((1 - 0.6 * sky.cloudiness) * clear + 0.6 * sky.cloudiness * np.array(sky.cloud))
    derived = {
        "sun_x": np.cos(elevation) * np.cos(azimuth),
        "sun_y": np.cos(elevation) * np.sin(azimuth),
        "sun_z": np.sin(elevation),
        "sun": c.sun.light,
        "sky_top": sky.top,
        "sky_low": sky.low,
        "cloud": sky.cloud,
        "cloud_shade": sky.shade,
        "cloudiness": sky.cloudiness,
        "cloud_seed": seed % 100_000,
        "above": above,
        "below": (0.2 + 0.45 * c.snow) * (above + 0.6 * np.array(c.sun.light) * np.sin(elevation)),
        "haze_colour": 0.75 * np.array(sky.low) + 0.25 * clear,
        "lit_seed": seed % 100_000 + 17,
        "beams": c.dark if beams else 0.0,
        "past": c.era == "past",
    }
    return record(LIGHT, {**{name: getattr(c, name) for name in LIGHT.names if name not in derived}, **derived})
