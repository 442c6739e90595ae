"""Long versions of what the tests check briefly, run by hand."""
