"""Mirrors of the run folder, each in a file of its own that alone imports its library."""
