"""Speed, measured by hand and told in ratios of one run."""
