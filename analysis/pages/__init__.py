"""Numbers and pages as people read them."""
