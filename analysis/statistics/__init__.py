"""What a handful of seeds can and cannot show."""
