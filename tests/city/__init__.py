"""Tests of artifact_city, which know nothing of artifact."""
