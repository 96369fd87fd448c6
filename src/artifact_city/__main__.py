"""Compile the renderer, so that the first images need not wait: ``python -m artifact_city``."""

import time

from artifact_city import compile_all

began = time.monotonic()
compile_all()
print(f"compiled the renderer in {time.monotonic() - began:.0f} s")  # noqa: T201
