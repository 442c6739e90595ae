"""Runs read from their folders, and which of them belong together."""
