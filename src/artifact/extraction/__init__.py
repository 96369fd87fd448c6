"""Traversal × method → descriptors on disk, in resumable shards; local features and codes of two-stage methods."""
