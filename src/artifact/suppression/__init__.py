"""Condition suppression: transforms, their composition, fitting and evaluation regions, guardedness probe."""

REVISION = 2  # raise when a fit changes: it is part of the key of everything fitted
