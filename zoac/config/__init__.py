"""From text to a checked configuration, and from that to objects."""
