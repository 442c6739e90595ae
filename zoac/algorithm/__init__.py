"""The tuning algorithm of the paper, equation by equation."""
