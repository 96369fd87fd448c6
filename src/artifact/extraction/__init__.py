"""Traversal × method → descriptors on disk, in parts, resumable at any moment; local features and codes of two-stage methods."""
