"""External co-simulation engines run the built FMUs and the exported SSP archives."""
