"""The configuration that Hydra composes: YAML files, shipped inside the package."""
