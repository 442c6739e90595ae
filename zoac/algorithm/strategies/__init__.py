"""What any tuner can be combined with."""
