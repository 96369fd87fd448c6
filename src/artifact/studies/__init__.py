"""One module per table and figure of the paper, and beyond: inputs named by the manifest, outputs as tidy frames.

Shares are in percent here, as the paper prints them. Every row says what it is from, and every study returns the
record of its inputs.
"""

from artifact.studies import (  # noqa: F401
    catalogue,
    common,
    composition,
    distractors,
    embedding,
    erased,
    evaluated,
    fitted,
    how_fast,
    how_sure,
    judging,
    mixed_database,
    per_query,
    preview,
    protocol,
    recall,
    reported,
    suppression,
    verdicts,
    within_session,
)
