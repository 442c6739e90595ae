"""The run folder: what is in it, how it is written, read and kept safe."""
