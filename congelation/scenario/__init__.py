"""Scenarios: what to run, read from TOML or SSP."""
