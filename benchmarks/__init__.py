"""Measurements of speed, run by hand and reported as ratios within one run."""
