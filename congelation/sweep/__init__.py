"""Scenarios carried out: plans, workers, runs."""
