"""Notebooks → executed notebooks → the built book."""
