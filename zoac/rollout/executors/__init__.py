"""Where environments run: here, in processes, on a cluster."""
