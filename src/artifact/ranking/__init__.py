"""One pass of similarity tiles gives per-query counts; candidates and matching of two-stage methods."""
