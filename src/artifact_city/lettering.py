"""Shop names, as patterns of dots that compiled code can look up."""

import numpy as np

NAMES = (
    "BAKERY", "CAFE", "BOOKS", "HOTEL", "FLORIST", "BARBER", "OPTICIAN", "PHARMACY", "TAILOR", "BISTRO", "CINEMA",
    "GALLERY", "SHOES", "TOYS", "MUSIC", "BANK", "GROCER", "BUTCHER", "CHEESE", "WINES", "TEA ROOM", "JEWELLER",
    "PRINTER", "BICYCLES", "CLOCKS", "TOBACCO", "DAIRY", "HARDWARE", "LIBRARY", "FISH", "PIZZA", "NOODLES", "RECORDS",
    "ANTIQUES", "SPICES", "LAUNDRY", "THEATRE", "PAPER",
)  # fmt: skip

# Five rows of five dots for each letter, top row first, each row's leftmost dot the highest bit.
_GLYPHS = {
    "A": (14, 17, 31, 17, 17), "B": (30, 17, 30, 17, 30), "C": (15, 16, 16, 16, 15), "D": (30, 17, 17, 17, 30),
    "E": (31, 16, 30, 16, 31), "F": (31, 16, 30, 16, 16), "G": (15, 16, 19, 17, 15), "H": (17, 17, 31, 17, 17),
    "I": (14, 4, 4, 4, 14), "J": (7, 2, 2, 18, 12), "K": (17, 18, 28, 18, 17), "L": (16, 16, 16, 16, 31),
    "M": (17, 27, 21, 17, 17), "N": (17, 25, 21, 19, 17), "O": (14, 17, 17, 17, 14), "P": (30, 17, 30, 16, 16),
    "Q": (14, 17, 21, 18, 13), "R": (30, 17, 30, 18, 17), "S": (15, 16, 14, 1, 30), "T": (31, 4, 4, 4, 4),
    "U": (17, 17, 17, 17, 14), "V": (17, 17, 17, 10, 4), "W": (17, 17, 21, 27, 17), "X": (17, 10, 4, 10, 17),
    "Y": (17, 10, 4, 4, 4), "Z": (31, 2, 4, 8, 31), " ": (0, 0, 0, 0, 0),
}  # fmt: skip

# (names, letters, rows of dots); a row of -1 marks the end of a name.
DOTS = np.full((len(NAMES), max(map(len, NAMES)), 5), -1, dtype=np.int64)
for _row, _name in enumerate(NAMES):
    for _place, _letter in enumerate(_name):
        DOTS[_row, _place] = _GLYPHS[_letter]
LENGTHS = np.array([len(name) for name in NAMES])
