"""Tables, figures and findings as a reader of the book sees them: one module per subject, as in ``studies``."""

from artifact.pages import (  # noqa: F401
    catalogue,
    common,
    composition,
    diagram,
    distractors,
    embedding,
    erased,
    galleries,
    mixed_database,
    opening,
    preview,
    protocol,
    provenance,
    recall,
    scope,
    style,
    suppression,
    verdicts,
    within_session,
)
