"""A run from the command line and from Python, and what all command lines share."""
