"""Plants from published sources, on which tuners are compared: `experiment=suite`."""
