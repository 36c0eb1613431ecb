"""Configs: from a YAML or TOML file to a validated experiment, with file, line and key in every error."""
