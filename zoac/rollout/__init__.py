"""The only place where an environment is stepped."""
