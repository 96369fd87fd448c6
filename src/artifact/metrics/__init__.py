"""R@K, DAR@K, RSR@K and their sweeps, of one-stage and two-stage methods, with intervals."""
