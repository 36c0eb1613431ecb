"""Sweep files: from YAML or TOML to validated rows."""
