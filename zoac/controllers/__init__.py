"""Controllers that come with zoac, and wrappers around a user's own."""
