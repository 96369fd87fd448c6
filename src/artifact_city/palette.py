"""Colours of walls, roofs, shops, cars and clothes in linear light, and arithmetic on colours for compiled code."""

import numpy as np

from artifact_city.kernel import kernel


def linear(code: str) -> tuple[float, float, float]:
    """Turn an sRGB colour code into linear light.

    >>> linear("ffffff")
    (1.0, 1.0, 1.0)
    >>> [round(value, 3) for value in linear("808080")]
    [0.216, 0.216, 0.216]
    """
    values = np.array([int(code[k : k + 2], 16) for k in (0, 2, 4)]) / 255
    values = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return tuple(float(v) for v in values)


def _table(codes: str) -> np.ndarray:
    return np.array([linear(code) for code in codes.split()])


BRICK = _table("8c4a36 7a3b2c 9a5a3f a86a4c 6b3a30 b08968 5d3b33 93604a c09a78 70483c")
PLASTER = _table(
    "e6dcc3 d9c79e e8e4da c9a66b d8b48a b9c4c4 d5a58a c2b59b a9b79a e3cfae cfd3d6 d98e73 8fa3b0 f0ead8 b5654a 7fa08a "
    "c96f5a e0b04f 6f8fb5 b98aa5"
)
STONE = _table("b7ad98 a39a88 8f8a80 c4b9a0 9c9184 7f7b74")
CONCRETE = _table("a9a8a3 8d8f91 c0bdb4 6f7478 b4a894 d3d2cd")
TIMBER = _table("efe6cf e7d8b1 dcc9a3 f1eee3 d8b98f")
SIDING = _table("e9e6dd 9fb3b5 c9b68f 7d2f28 d7d9c7 5f7480 b9a35a 8b9a83")
TRIM = _table("efeae0 d8d0bf f5f3ee b6aa93 cfc7b5 4a4a46 6b5a48")
ROOF = _table("8a4a36 6e3a2d 4a4a50 3c3f45 a05a3e 5b4a44 70655c 94523a")
DOOR = _table("2f4a3a 5b2420 23324a 6b4a2b 1e1e20 7a2e2a 3f5d63 8a6a3a c8bda4 2d5a4a")
SIGN = _table(
    "a3221f 1f4e8c 14603a d8a51f 20242c 6a2c6e d9582b 0f7a86 e8e2d0 7a1f34 3a6b1f c7452f 2b2f7a e3c04a b8417a"
)
CAR = _table(
    "b9bdc1 e9eaea 15171a 34383d 6b7075 8c1c1c 1d3b6b 2f4f7f 4a5b4a c9bfa8 7f1d2b d7d9dc 26282b b5541f e0c23a 3d7a86"
)
CLOTHES = _table("20242c 3a4a63 7a2e2a c9b68f 56585c a8b0b8 2f4a3a 8a3b5a d8d2c4 1d3b6b b5541f")
OLD_CLOTHES = _table("1a1a1a 2b2724 3a352f 4a453e 151515 6a6358")
AWNING = _table("a3221f 1f4e8c 14603a d9b24a e6dcc3 7a1f34 d9582b 4a4a46 0f7a86")


def choose(rng: np.random.Generator, table: np.ndarray) -> np.ndarray:
    """Draw one row of a colour table and vary its brightness a little."""
    return np.clip(table[rng.integers(len(table))] * rng.uniform(0.85, 1.12), 0.0, 0.95)


@kernel
def scaled(colour, factor):
    """Brighten or darken a colour."""
    return colour[0] * factor, colour[1] * factor, colour[2] * factor


@kernel
def filtered(colour, other):
    """Multiply two colours: light on a surface, or the tint of a surface."""
    return colour[0] * other[0], colour[1] * other[1], colour[2] * other[2]


@kernel
def added(colour, other, factor):
    """Add ``factor`` times another colour."""
    return colour[0] + factor * other[0], colour[1] + factor * other[1], colour[2] + factor * other[2]


@kernel
def mixed(colour, other, share):
    """Blend another colour over one."""
    return (
        colour[0] + share * (other[0] - colour[0]),
        colour[1] + share * (other[1] - colour[1]),
        colour[2] + share * (other[2] - colour[2]),
    )


@kernel
def blend(pixel, colour, share):
    """Blend a colour over a pixel of an image, in place."""
    for k in range(3):
        pixel[k] += share * (colour[k] - pixel[k])


@kernel
def accumulate(pixel, colour, share):
    """Add a share of a colour to a pixel of an image, in place."""
    for k in range(3):
        pixel[k] += share * colour[k]


@kernel
def put(target, colour):
    """Write a colour to a record's field or a pixel."""
    for k in range(3):
        target[k] = colour[k]
