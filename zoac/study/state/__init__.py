"""What a study knows: settings, trials, and how they are kept on disk."""
